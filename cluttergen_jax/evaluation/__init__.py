"""Evaluation: trials and their measures, studies (a table or figure each), suites of them, reports.

trial: what one row asks. resolved: what its names stand for. checkpoints: where policies lie. episodes:
running it. row: its figures. store: rows on disk, found again by content. runner: all of these.
studies: one module for each table or figure. suites: which studies there are. running: making them.
comparison: methods side by side. published: the paper's setting. cells, plots: what studies share.
report, document: what people read.
"""
