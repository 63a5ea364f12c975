"""XML files as trees, and their tags without namespaces."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

Element = ElementTree.Element
BROKEN = (OSError, ElementTree.ParseError, ValueError, LookupError)
"""What a file that is no XML, or in no known encoding, raises."""


def parse_xml(path: Path) -> Element | None:
    """The root of a file; None where it is no XML, of which whoever reads it for good tells."""
    try:
        return ElementTree.parse(path).getroot()
    except BROKEN:
        return None


def plain_tag(element: Element) -> str:
    """An element's tag without its namespace."""
    return str(element.tag).rpartition("}")[2]


def without_namespace(root: Element) -> Element:
    """The tree with plain tags for all elements in the namespace of its root, such as Drake's."""
    space = str(root.tag).rpartition("}")[0]
    for element in root.iter() if space else ():
        if str(element.tag).startswith(space + "}"):
            element.tag = plain_tag(element)
    return root
