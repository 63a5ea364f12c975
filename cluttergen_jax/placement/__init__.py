"""The placement problem: world, region, decision process, observation, environment, baselines, rollouts."""
