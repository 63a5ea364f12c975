"""The studies, one module for each table or figure: trials, measure, tables, pictures, the paper's numbers.

`evaluation.suites` lists them.
"""
