"""Importing: from files to pools of measured bodies.

solo: whether an object stands alone. worker: one object from source to files. cache: what was made before.
table: a table as a support.
run: many objects in parallel, and the report.
"""
