"""XML files as trees without namespaces, and numbers in them: errors name file, element and attribute."""

from __future__ import annotations

import math
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from cluttergen_jax.errors import AssetError

Element = ElementTree.Element
BROKEN = (OSError, ElementTree.ParseError, ValueError, LookupError)
"""What a file that is no XML, or in no known encoding, raises."""


def parse_xml(path: Path) -> Element | None:
    """The root of a file; None where it is no XML, which the format's own reader reports."""
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


def numbers(
    path: Path, element: Element, name: str, count: int, default: str | None = None, is_finite: bool = True
) -> np.ndarray:
    """f64[count]: the numbers of an attribute, or of `default` where it is absent.

    Args:
      path: the file, for the message.
      is_finite: refuse infinite numbers and NaN.

    Raises:
      AssetError: the attribute is absent and has no default, or does not hold `count` numbers.
    """
    values = all_numbers(path, element, name, default)
    if len(values) != count or (is_finite and not all(map(math.isfinite, values))):
        raise wrong_attribute(path, element, name, "1 number" if count == 1 else f"{count} numbers")
    return np.array(values)


def number(
    path: Path, element: Element, name: str, default: str | None = None, is_finite: bool = True
) -> float:
    """One number; see `numbers`."""
    return float(numbers(path, element, name, 1, default, is_finite)[0])


def length(path: Path, element: Element, name: str) -> float:
    """One number above zero, such as a radius; see `numbers`."""
    value = number(path, element, name)
    if value <= 0:
        raise wrong_attribute(path, element, name, "a number above 0")
    return value


def all_numbers(path: Path, element: Element, name: str, default: str | None = None) -> list[float]:
    """All numbers of an attribute, however many.

    Raises:
      AssetError: the attribute is absent and has no default, or holds something else.
    """
    text = attribute_text(element, name)
    text = default if text is None else text
    if text is None:
        # Formats with elements inside write all values as elements.
        if len(element):
            raise AssetError(f"{path}: a <{element.tag}> without <{name}>")
        raise AssetError(
            f"{path}: a <{element.tag}> without the attribute {name!r}", f"<{element.tag} {name}=...>"
        )
    if (values := parse_numbers(text)) is None:
        raise wrong_attribute(path, element, name, "numbers with spaces between them")
    return values


def parse_numbers(text: str) -> list[float] | None:
    """The numbers of a text with spaces between them; None where a word is none."""
    try:
        return [float(word) for word in text.split()]
    except ValueError:
        return None


def wrong_attribute(path: Path, element: Element, name: str, allowed: str) -> AssetError:
    """What to raise for an attribute whose value cannot be taken."""
    text = attribute_text(element, name) or ""
    inside = f"<{element.tag}><{name}>{text}</{name}>" if element.find(name) is not None else ""
    return AssetError(f"{path}: " + (inside or f'<{element.tag} {name}="{text}">'), allowed)


def attribute_text(element: Element, name: str) -> str | None:
    """The text of an attribute, or as SDF has it of an element within; None if there is neither."""
    inside = element.find(name)
    return element.get(name, None if inside is None else inside.text or "")
