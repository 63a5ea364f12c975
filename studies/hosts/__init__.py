"""Exports in their hosts: each host's environment made from the package index, and scenes run there.

`table` says which hosts there are and how each is installed; `environment`, `bank` and `measurement` make and
keep what is needed; `page` writes the table and the commands of docs/guide/hosts.md; `programs` holds what
runs in a host's own interpreter.
"""
