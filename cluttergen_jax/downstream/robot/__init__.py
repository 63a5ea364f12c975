"""A robot arm in simulation: grasps, motion, and objects picked up and put down."""
