"""Puts a description into the XML of an LSL stream, and reads the XML of one."""

from __future__ import annotations

import re
from typing import Protocol, Self
from xml.etree.ElementTree import Element, ParseError, fromstring

from biosensor_common.errors import SpecError, SpecReason

# What XML 1.0 cannot hold (https://www.w3.org/TR/xml/#charsets): LSL would write it all the same,
# and no program could read the header, nor pyxdf the recording.
_NO_XML = re.compile("[^\t\n\r\\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


class XmlNode(Protocol):
    """What of ``pylsl.XMLElement`` it takes."""

    def append_child(self, name: str, /) -> Self:
        """Append an element and return it."""
        ...

    def append_child_value(self, name: str, value: str, /) -> Self:
        """Append an element with a text."""
        ...


def append_children(parent: XmlNode, element: Element) -> None:
    """Append all that is in an element; texts beside elements, and attributes, are left out.

    What XML has no character for, as most control characters, becomes U+FFFD.
    """
    for child in element:
        if len(child):
            append_children(parent.append_child(child.tag), child)
        else:
            parent.append_child_value(child.tag, xml_text(child.text or ""))


def xml_text(text: str) -> str:
    """Return a text with U+FFFD for what XML has no character for."""
    return _NO_XML.sub("\N{REPLACEMENT CHARACTER}", text)


def read_xml(xml: str, most_characters: int) -> Element:
    """Parse XML that somebody else has written.

    Raises
    ------
    SpecError
        ``TOO_LARGE`` or ``MALFORMED``, the latter also for a document type.
    """
    if len(xml) > most_characters:
        message = f"the XML has {len(xml)} characters, more than {most_characters}"
        raise SpecError(SpecReason.TOO_LARGE, message)
    if "<!" in xml.replace("<!--", ""):
        # Document types and entities have no place here and are how XML parsers are attacked.
        raise SpecError(SpecReason.MALFORMED, "the XML has a document type")
    try:
        return fromstring(xml)  # noqa: S314 - no document type, limited in size
    except (ParseError, ValueError) as error:
        # ValueError: a lone surrogate, which has no UTF-8 form.
        raise SpecError(SpecReason.MALFORMED, f"the XML is not well-formed ({error})") from error
