"""Runs of the learner: progress, records, checkpoints, and taking them up again."""
