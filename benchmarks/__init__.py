"""Programs that measure: `python -m benchmarks.NAME [--write]`; reports/benchmarks.md holds what they wrote."""
