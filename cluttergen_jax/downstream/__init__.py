"""What is done with scenes: stable placement from what a camera sees."""
