"""Looking at scenes: in a browser (`Viewer`, extra `viewer`), or in MuJoCo's own window (`show_native`).

source: where scenes come from. scene_nodes: what the browser draws. words: what is said of a scene.
server: the web server. viewer: all browsers. session: one browser, its panel and what its buttons do. native:
MuJoCo's viewer.
"""
