"""What must be in an XML document: its absence is an error that names it."""

from __future__ import annotations

from xml.etree import ElementTree as ET


def child(element: ET.Element, path: str) -> ET.Element:
    """Returns the first element at a path below this one.

    Raises:
        ValueError: there is none.
    """
    found = element.find(path)
    if found is None:
        raise ValueError(f"the element <{element.tag}> has no {path}")
    return found


def attribute(element: ET.Element, name: str) -> str:
    """Returns the value of an attribute.

    Raises:
        ValueError: the element does not have it.
    """
    value = element.get(name)
    if value is None:
        raise ValueError(f"the element <{element.tag}> has no attribute {name}")
    return value
