"""Importing: from files to pools of measured bodies.

readers: of files. planning: which objects will be made. settings: how. processes: each in one of its own.
solo_stability: whether an object stands alone. cache: what was made before. run: many objects, and the
report. supports: furniture as a support.
"""
