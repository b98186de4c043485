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
    """A licence text or notice.

    Attributes
    ----------
    path
        Below ``licenses/``, with ``/``.
    content
        As it was shipped.
    """

    path: str
    content: bytes


@dataclass(frozen=True, slots=True)
class Component:
    """Something that has a licence of its own.

    Attributes
    ----------
    name, version, purl
        Version and package URL are None where nothing says them.
    licence
        SPDX expression.
    files
        Those of its files that are in the bundle.
    modules
        Dotted names of its modules inside the program or ``base_library.zip``.
    texts
        Its licence texts.
    parts
        Components inside its files.
    needs
        Names of components that it depends on, as far as they are in the bundle.
    note
        One sentence on its licence, where that needs one.
    supplier
        Whom it is from; empty where nothing says it.
    """

    name: str
    version: str | None
    purl: str | None
    licence: str
    files: tuple[BundledFile, ...] = ()
    modules: tuple[str, ...] = ()
    texts: tuple[Text, ...] = ()
    parts: tuple[Component, ...] = ()
    needs: tuple[str, ...] = ()
    note: str = ""
    supplier: str = ""


@dataclass(slots=True)
class Holding:
    """What of the bundle one owner has; filled while the bundle is gone through."""

    files: list[BundledFile] = field(default_factory=list["BundledFile"])
    modules: set[str] = field(default_factory=set[str])
