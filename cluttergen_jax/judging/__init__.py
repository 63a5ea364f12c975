"""Judges scenes: saved ones, anybody's, and how firmly those of a bank stand."""
