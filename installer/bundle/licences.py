"""Collects the licence texts of components."""

from __future__ import annotations

import re
from pathlib import PurePosixPath

from installer.bundle import known
from installer.bundle.cpython import NAME, CPython
from installer.bundle.distributions import Distribution
from installer.bundle.errors import MissingTextError
from installer.bundle.expressions import choice, may_ship
from installer.bundle.model import Text
from installer.bundle.texts import common_text, generic_identifiers, kept_text

_TEXT_NAME = re.compile(r"(LICEN[CS]E|COPYING|COPYRIGHT|NOTICE|AUTHORS)([._-].*)?", re.IGNORECASE)
_BOM = b"\xef\xbb\xbf"


def distribution_texts(distribution: Distribution, licence: str) -> tuple[Text, ...]:
    """Return the licence texts and notices of a distribution.

    They are those that its wheel brought; else one that is kept for it.

    Raises
    ------
    MissingTextError
        If there is none.
    """
    shipped: list[Text] = []
    for path in sorted(distribution.record):
        below = PurePosixPath(path)
        if below.parts[0] != distribution.info:
            continue
        in_licences = below.parts[1] == "licenses"
        if in_licences or (len(below.parts) == 2 and _TEXT_NAME.fullmatch(below.name)):
            inner = PurePosixPath(*below.parts[2 if in_licences else 1 :])
            shipped.append(Text(f"{distribution.name}/{inner}", distribution.read(path)))
    if not any(text.content.removeprefix(_BOM).strip() for text in shipped):
        shipped = list(component_texts(distribution.name, licence))
    return (*shipped, *_further(distribution.name))


def cpython_texts(python: CPython) -> tuple[Text, ...]:
    """Return the licence texts of CPython.

    Raises
    ------
    MissingTextError
        If the Python has none with it.
    """
    if not python.licence_text.is_file():
        message = f"{python.licence_text} is missing; it is a part of every CPython for Windows."
        raise MissingTextError(message)
    own = Text(f"{NAME}/LICENSE.txt", python.licence_text.read_bytes())
    return (own, *_further(NAME))


def component_texts(name: str, licence: str) -> tuple[Text, ...]:
    """Return the texts for a component that brought none itself.

    There is none for what must not be shipped: that is refused for its licence, all at once.

    Raises
    ------
    MissingTextError
        If none is kept for it and its licence is none that needs no notice of its own.
    """
    if not may_ship(licence):
        return ()
    kept = kept_text(name)
    if kept is not None:
        return (kept,)
    chosen = choice(licence, generic_identifiers())
    if chosen is None:
        message = (
            f"There is no licence text for {name} ({licence}); add one to installer/bundle/texts "
            "and name its source in sources.toml there."
        )
        raise MissingTextError(message)
    return tuple(common_text(identifier) for identifier in chosen)


def _further(name: str) -> tuple[Text, ...]:
    return tuple(common_text(stem) for stem in known.FURTHER_TEXTS.get(name, ()))
