"""Poses of known objects from depth: registration from many turns, each judged by what it would look like."""
