"""Programs that measure: `python -m benchmarks.NAME [--write]`; reports/benchmarks.md has what they wrote."""
