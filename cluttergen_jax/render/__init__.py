"""Pictures of objects, supports and scenes.

gl: whether and how this machine can draw. dress: light, floor and background. camera: framing.
sampling: soft light and smooth edges. picture: one model as an image. sheet: contact sheets and files.
assets: objects, supports and scenes.
"""
