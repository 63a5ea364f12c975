"""Studies of a checkout, which the wheel leaves out: tables, figures and measurements of the package.

study: what a study is. suites: which there are. methods: tables and figures of placement methods. downstream:
what scenes are good for. measures: of finished scenes, what studies alone ask. running, report: makes results
and the page of all of them, which `make_results` writes. benchmarks: programs that measure.
"""
