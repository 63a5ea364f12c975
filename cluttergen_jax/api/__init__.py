"""The Python API: every command has a function of the same defaults. Only a call imports what it needs.

The command line is made from these functions: their arguments are its options, their docstrings its help.
"""
