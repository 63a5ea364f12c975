"""Heads: what learns from pairs and proposes poses, and the trained ones on disk."""
