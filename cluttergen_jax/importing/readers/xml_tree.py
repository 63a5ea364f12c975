"""XML files as trees without namespaces, and numbers in them: errors name file, element and attribute.

What XML's own rules refuse is read by those of tinyxml2, with which Gazebo, Drake, PyBullet and MuJoCo read:
prefixes need no declaration, `&` and `<` may stand in values, and encodings that a file states are its own
affair.
"""

from __future__ import annotations

import math
import re
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from cluttergen_jax.errors import AssetError
from cluttergen_jax.importing.readers.opening import MOST_XML, as_utf8, read_file

Element = ElementTree.Element
BROKEN = (OSError, ElementTree.ParseError, ValueError, LookupError)
"""What a file that is no XML raises."""
_MOST_DEEP = 400
"""Elements within each other. tinyxml2 stops at 500."""
_TOO_DEEP = f"its elements lie within each other, more than {_MOST_DEEP} deep"
_MOST_ELEMENTS = 2_000_000


def parse_xml(path: Path) -> Element | None:
    """The root of a file; None where it is no XML, which the format's own reader reports."""
    try:
        return read_xml(path)
    except (*BROKEN, AssetError):
        return None


def read_xml(path: Path) -> Element:
    """The root of a file.

    Raises:
      OSError, ParseError, ValueError, LookupError: it cannot be read, or is no XML (`BROKEN`).
      AssetError: it is no regular file, or too large.
    """
    return parse_text(read_file(path, MOST_XML))


def parse_text(data: bytes) -> Element:
    """The root of an XML text; see `read_xml`."""
    if _OWN_DECLARATIONS.search(data):
        raise ValueError(
            "it declares entities or a document type of its own (<!DOCTYPE ... [), which is not read"
        )
    try:
        root = ElementTree.fromstring(data)
    except (ElementTree.ParseError, ValueError, LookupError):
        if (lenient := _parse_as_tinyxml(as_utf8(data).decode())) is None:
            raise
        root = lenient
    _check_extent(root)
    return root


_OWN_DECLARATIONS = re.compile(rb"<!DOCTYPE[^>\[]*+\[|<!ENTITY")


def _check_extent(root: Element) -> None:
    todo = [(root, 1)]
    count = 0
    while todo:
        element, depth = todo.pop()
        count += 1
        if depth > _MOST_DEEP:
            raise ValueError(_TOO_DEEP)
        if count > _MOST_ELEMENTS:
            raise ValueError(f"it has more than {_MOST_ELEMENTS:,} elements")
        todo += [(child, depth + 1) for child in element]


_NAME = r"[A-Za-z_:\x80-\U0010ffff][\w:.\-\x80-\U0010ffff]*+"
_VALUE = r"\"[^\"]*+\"|'[^']*+'"
_ATTRIBUTE = re.compile(rf"\s*+({_NAME})\s*+=\s*+({_VALUE})")
# Nothing in it is tried a second time: its time is proportional to the text.
_TAG = re.compile(
    rf"<(?P<name>{_NAME})(?P<values>(?:\s*+{_NAME}\s*+=\s*+(?:{_VALUE}))*+)\s*+(?P<end>/?)>"
)
_END_TAG = re.compile(rf"</\s*+({_NAME})\s*+>")
_PASSED_OVER = (("<!--", "-->"), ("<?", "?>"), ("<!", ">"))
_CDATA = ("<![CDATA[", "]]>")
_REFERENCE = re.compile(r"&(?:#x([0-9a-fA-F]{1,6})|#([0-9]{1,7})|(quot|amp|apos|lt|gt));")
_MEANT = {"quot": '"', "amp": "&", "apos": "'", "lt": "<", "gt": ">"}


def _parse_as_tinyxml(text: str) -> Element | None:
    """The tree of a text by tinyxml2's rules; None if it is none by these either.

    Text before the root and behind it is passed over. A prefix that is not declared counts as the name of its
    own namespace, of an attribute that comes twice the first holds, and an entity that is unknown is text.
    """
    builder = ElementTree.TreeBuilder()
    open_tags = list[str]()
    is_over = False
    place = 0
    while 0 <= place < len(text):
        start = text.find("<", place)
        start = len(text) if start < 0 else start
        if open_tags:
            builder.data(_plain_text(text[place:start]))
        if start == len(text):
            break
        if text.startswith(_CDATA[0], start):
            place = _behind(text, start, _CDATA)
            if open_tags:
                builder.data(text[start + len(_CDATA[0]) : place - len(_CDATA[1])])
        elif ends := next((ends for ends in _PASSED_OVER if text.startswith(ends[0], start)), None):
            place = _behind(text, start, ends)
        elif found := _END_TAG.match(text, start):
            if not open_tags or open_tags.pop() != found[1]:
                return None
            builder.end(_expand(found[1]))
            is_over = not open_tags
            place = found.end()
        elif found := _TAG.match(text, start):
            if is_over:
                return None
            builder.start(_expand(found["name"]), _attributes(found["values"]))
            open_tags.append(found["name"])
            place = found.end()
            if found["end"]:
                builder.end(_expand(open_tags.pop()))
                is_over = not open_tags
        else:
            return None
    return builder.close() if is_over and place >= 0 else None


def _behind(text: str, start: int, ends: tuple[str, str]) -> int:
    """The place behind what begins at `start`; -1 if it has no end."""
    end = text.find(ends[1], start + len(ends[0]))
    return end if end < 0 else end + len(ends[1])


def _attributes(text: str) -> dict[str, str]:
    found = [(name, value[1:-1]) for name, value in _ATTRIBUTE.findall(text)]
    # Of one that comes twice the first holds.
    return {
        _expand(name): _plain_text(value)
        for name, value in reversed(found)
        if not name.startswith("xmlns")
    }


def _expand(name: str) -> str:
    prefix, _, own = name.rpartition(":")
    return f"{{{prefix}}}{own}" if prefix and own else name


def _plain_text(text: str) -> str:
    return _REFERENCE.sub(_meant, text) if "&" in text else text


def _meant(found: re.Match[str]) -> str:
    if found[3]:
        return _MEANT[found[3]]
    number = int(found[1], 16) if found[1] else int(found[2])
    return chr(number) if 0 < number <= 0x10FFFF and not 0xD800 <= number < 0xE000 else found[0]


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
    path: Path,
    element: Element,
    name: str,
    count: int,
    default: str | None = None,
    is_finite: bool = True,
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
            f"{path}: a <{element.tag}> without the attribute {name!r}",
            f"<{element.tag} {name}=...>",
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
