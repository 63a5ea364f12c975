"""Looking at scenes: in a browser (`Viewer`, extra `viewer`), or in MuJoCo's own window (`show_native`); and
making them by hand (`PlacingPanel`).

source: where scenes come from, and go to. scene_nodes: what the browser draws. words: what is said of them.
guard: the web server, and who is let in. viewer: all browsers, the panel of each, and MuJoCo's own viewer.
placing: the panel for making scenes by hand.
"""
