"""Surfaces of files made fit to be drawn and cut: without folds, facing outwards, of few triangles."""
