"""Writes and parses the XML description of an LSL stream."""

from __future__ import annotations

import re
from typing import Protocol, Self
from xml.etree.ElementTree import Element, ParseError, fromstring

from biosensor_common.errors import SpecError, SpecReason

# Characters that XML 1.0 forbids (https://www.w3.org/TR/xml/#charsets). liblsl writes them anyway,
# and then no program can parse the header, and pyxdf cannot load the recording.
_NO_XML = re.compile("[^\t\n\r\\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


class XmlNode(Protocol):
    """The methods of ``pylsl.XMLElement`` that are used here."""

    def append_child(self, name: str, /) -> Self:
        """Append an element and return it."""
        ...

    def append_child_value(self, name: str, value: str, /) -> Self:
        """Append an element with a text."""
        ...


def append_children(parent: XmlNode, element: Element) -> None:
    """Append the children of an element, without attributes and mixed text.

    Characters that XML forbids, such as most control characters, become U+FFFD.
    """
    for child in element:
        if len(child):
            append_children(parent.append_child(child.tag), child)
        else:
            parent.append_child_value(child.tag, xml_text(child.text or ""))


def xml_text(text: str) -> str:
    """Return a text with U+FFFD in place of characters that XML forbids."""
    return _NO_XML.sub("\N{REPLACEMENT CHARACTER}", text)


def read_xml(xml: str, most_characters: int) -> Element:
    """Parse XML from an untrusted source.

    Raises
    ------
    SpecError
        ``TOO_LARGE``; ``MALFORMED``, also if there is a document type.
    """
    if len(xml) > most_characters:
        message = f"the XML has {len(xml)} characters, more than {most_characters}"
        raise SpecError(SpecReason.TOO_LARGE, message)
    if "<!" in xml.replace("<!--", ""):
        # XML parsers are attacked by document types and entities, and no stream needs them.
        raise SpecError(SpecReason.MALFORMED, "the XML has a document type")
    try:
        return fromstring(xml)  # noqa: S314 - no document type, limited in size
    except (ParseError, ValueError) as error:
        # ValueError: a lone surrogate cannot be encoded as UTF-8.
        raise SpecError(SpecReason.MALFORMED, f"the XML is not well-formed ({error})") from error
