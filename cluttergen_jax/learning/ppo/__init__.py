"""PPO for any environment with Brax's protocol."""
