"""Evaluation: trials and their measures, methods side by side, certificates of banks.

trial: what one row asks. resolved: what its names stand for, its policy among them. episodes: running it, and
its figures. store: rows on disk, found again by content. runner: all of these. comparison: methods side by
side. cells, plots: columns and figures. certify: stability certificates of banks.
"""
