"""Training a placer: examples made of pairs, fitting, presets, and the run."""
