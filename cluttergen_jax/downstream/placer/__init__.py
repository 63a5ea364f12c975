"""Placers: proposals of where an object will stand, from one camera's view of a partial scene."""
