"""Evaluation: trials and their measures, studies (a table or figure each), suites of them, reports.

trial: what one row asks. resolved: what its names stand for, its policy among them. episodes: running it, and
its figures. store: rows on disk, found again by content. runner: all of these. studies: one module for each
table or figure. suites: which studies there are. running: making them. comparison: methods side by side.
cells, plots: what studies share. report: what people read. certify: stability certificates of banks.
"""
