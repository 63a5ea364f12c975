"""Learning to place: networks, PPO, agents and their policies, training runs."""
