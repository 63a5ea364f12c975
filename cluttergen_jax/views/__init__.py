"""Datasets of views: what cameras see of the scenes of banks, in files for trainers."""
