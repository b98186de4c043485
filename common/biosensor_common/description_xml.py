"""Puts a description into the XML of an LSL stream."""

from __future__ import annotations

from typing import Protocol, Self
from xml.etree.ElementTree import Element


class XmlNode(Protocol):
    """What of ``pylsl.XMLElement`` it takes."""

    def append_child(self, name: str, /) -> Self:
        """Append an element and return it."""
        ...

    def append_child_value(self, name: str, value: str, /) -> Self:
        """Append an element with a text."""
        ...


def append_children(parent: XmlNode, element: Element) -> None:
    """Append all that is in an element; texts beside elements, and attributes, are left out."""
    for child in element:
        if len(child):
            append_children(parent.append_child(child.tag), child)
        else:
            parent.append_child_value(child.tag, child.text or "")
