"""Studies of what scenes are good for: stable placement, perception, a robot."""
