"""Every table and figure: trials, suites of them, and reports.

trial: what one row asks. episodes: running it. record: its figures. scenes: its scenes, for measures. store:
results on disk, found again by content. checkpoints: where policies lie. lab: all of these together. suites:
the tables as data. studies, measuring, timing: running one of them. published: the paper's figures. layouts,
honest_layouts, tables, plots, pictures, report, document: what people read. progress: what the terminal shows
meanwhile. machine: what a table was made on. proportion: intervals.
"""
