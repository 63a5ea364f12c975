"""Fitting of networks to examples: gradient steps, and runs that are taken up again."""
