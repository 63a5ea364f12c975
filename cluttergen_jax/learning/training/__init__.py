"""Runs of the learner: progress, records, checkpoints, and resuming them."""
