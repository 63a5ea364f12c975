"""Objects, supports and pools as values and files, and the modeller that makes the embedded ones. No JAX."""
