"""A robot arm in simulation: episodes in which objects are picked up and put down."""
