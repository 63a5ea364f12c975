"""Cluttered, physically stable, diverse tabletop scenes on JAX and MuJoCo.

problem: from names to a compiled world, its physics and its rules (`make_problem`).
placement: the decision process; `placement.env.PlacementEnv` is a Brax environment.
baselines, policies: who proposes poses. sampling: whole episodes in compiled blocks.
bank: scenes on disk. render: pictures. importing: from any mesh to a sound body. training: PPO.
Below them: world, agent; assets, physics, networks; types, config, errors.
"""
