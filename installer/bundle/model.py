"""A component of a bundle, and what belongs to it."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass(frozen=True, slots=True, order=True)
class BundledFile:
    """A file of the installation: its path below the bundle, with ``/``, and its SHA-256 (hex)."""

    path: str
    sha256: str


@dataclass(frozen=True, slots=True)
class Text:
    """A licence text or notice."""

    path: str  # Below `licenses/`, with `/`.
    content: bytes  # As it was shipped.


@dataclass(frozen=True, slots=True)
class Component:
    """Something that has a licence of its own."""

    # name, version, purl: version and package URL are None where nothing says them.
    name: str
    version: str | None
    purl: str | None
    licence: str  # SPDX expression.
    files: tuple[BundledFile, ...] = ()  # Those of its files that are in the bundle.
    # Dotted names of its modules inside the program or `base_library.zip`.
    modules: tuple[str, ...] = ()
    texts: tuple[Text, ...] = ()  # Its licence texts.
    parts: tuple[Component, ...] = ()  # Components inside its files.
    # Names of components that it depends on, as far as they are in the bundle.
    needs: tuple[str, ...] = ()
    note: str = ""  # One sentence on its licence, where that needs one.
    supplier: str = ""  # Whom it is from; empty where nothing says it.


@dataclass(slots=True)
class Holding:
    """The files of one owner in the bundle; filled during the search of the bundle."""

    files: list[BundledFile] = field(default_factory=list["BundledFile"])
    modules: set[str] = field(default_factory=set[str])
