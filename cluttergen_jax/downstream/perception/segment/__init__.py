"""Segmentation: which object each pixel shows, by a small network or by whoever does it better."""
