"""What several tests share: worlds, banks, runs, shapes, probes, made files."""
