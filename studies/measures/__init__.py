"""Measures of finished scenes that studies alone ask.

acceptance: what passes less often than it is proposed. diversity: of a method's scenes. relations: on, in,
under, leaning. survival: the same scenes in PyBullet or Drake; bullet_world: PyBullet's world of them.
"""
