"""Importing: from files to pools of measured bodies.

solo: whether an object stands alone. worker: one object from source to files. cache: what was made before.
run: many objects in parallel, and the report.
"""
