"""What scenes are used for: stable placement from what a camera sees, and a robot arm."""
