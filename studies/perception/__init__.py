"""The observer: views to train and judge it with, its segmenter's training, and how well it finds."""
