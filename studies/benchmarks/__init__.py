"""Programs that measure: `python -m studies.benchmarks.NAME [--write]` writes to reports/benchmarks.md."""
