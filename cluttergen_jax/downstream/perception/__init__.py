"""Perception: known objects in colour and depth images, by a small network and classical registration."""
