"""The Python API: what a command does, one function does. Only calling one imports what it needs.

The command line is made from these functions: their arguments are its options, their docstrings its help.
"""
