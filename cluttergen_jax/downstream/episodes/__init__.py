"""Episodes of a robot in scenes: what simulates and judges them, and an environment of Gymnasium.

Nothing here needs more than NumPy, MuJoCo, Gymnasium and Python 3.11, so that the export `lerobot` copies it
beside a bank, with the few modules of the package that it stands on (`environments.exporting`).
"""
