"""Pictures of objects, supports and scenes.

gl: which OpenGL backend draws here. lighting: light, floor and background. camera: framing. renderer: many
pictures of one model, averaged. picture: one model as an image. sheet: contact sheets and files. assets:
objects, supports and scenes.
"""
