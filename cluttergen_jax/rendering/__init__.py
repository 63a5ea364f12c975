"""Pictures of objects, supports and scenes.

gl: which OpenGL backend draws here. lighting: light, floor and background. camera: framing.
sampling: soft light and smooth edges. picture: one model as an image. sheet: contact sheets and files.
assets: objects, supports and scenes.
"""
