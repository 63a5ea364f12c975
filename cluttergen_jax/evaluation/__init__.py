"""Every table and figure: trials, suites of them, and reports.

trial: what one row asks. changes: queried regions changed at random. episodes: running it. record: its
figures. store: results on disk, found again by content. checkpoints: where policies lie. lab: all of these
together. suites: the tables as data. studies, measuring: running one of them. published: the paper's figures.
tables, layouts, figures, report, document: what people read.
"""
