"""Looking at scenes: in a browser (`Viewer`, extra `viewer`), or in MuJoCo's own window (`show_native`).

source: where scenes come from. scenery: a scene as nodes of the browser's scene. words: what is said of it.
server: the web server. viewer: all browsers. session: one browser, its panel and what its buttons do. native:
MuJoCo's viewer.
"""
