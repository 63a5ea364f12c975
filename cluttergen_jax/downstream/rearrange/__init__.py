"""Rearrangement: a robot arm brings objects of a scene into one of several new layouts."""
