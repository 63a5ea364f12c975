"""What the help of a command tells of its options."""

import re


def options_in(help_text):
    """The flags of each option in a help text of wide lines, and what is told of its default."""
    text = re.sub(r"\x1b\[[0-9;]*m", "", help_text).replace("│", " ")
    assert "{None" not in text
    told = {}
    # An option begins its line after two spaces; what is said of it may go on below, further in.
    for entry in re.findall(r"^  --?[a-z].*(?:\n {3,}\S.*)*", text, re.MULTILINE):
        flags = re.findall(r"(?<![\w-])-{1,2}[a-z][\w-]*", re.split(r"(?<=\S) {2}|\n", entry)[0])
        default = re.search(r"\((default: .*|required|optional)\)$", " ".join(entry.split()))
        told[", ".join(sorted(flags))] = default and default[1]
    return {flags: default for flags, default in told.items() if flags != "--help, -h"}
