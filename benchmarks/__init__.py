"""Programs that measure: `python -m benchmarks.NAME [--write]`; README.md holds what they wrote."""
