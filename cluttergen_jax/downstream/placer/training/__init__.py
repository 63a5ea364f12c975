"""Training a placer: lessons made of pairs, fitting, presets, and the run."""
