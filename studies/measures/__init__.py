"""Measures of finished scenes that studies alone ask; see `cluttergen_jax.evaluation.measures`.

acceptance: what passes less often than it is proposed. relations: on, in, under, leaning. survival: the same
scenes in PyBullet or Drake; bullet_world: PyBullet's world of them.
"""
