"""The Python distributions that a bundle was made from, as their ``dist-info`` describes them."""

from __future__ import annotations

import base64
import csv
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from email.message import Message
from email.parser import Parser
from functools import cached_property
from pathlib import Path

from installer.bundle.names import normalised

_ADDRESS = re.compile(r"<[^>]*>")
_INDEX = "Python Package Index"


@dataclass(frozen=True)
class Distribution:
    """An installed distribution."""

    folder: Path  # Where it is installed; the paths of its record are below this.
    info: str  # Name of its `dist-info` folder.
    metadata: Message[str, str]  # Its `METADATA`.
    # Path, with `/`, to SHA-256 (hex) of each of its files; None where none is recorded.
    record: Mapping[str, str | None]

    @cached_property
    def name(self) -> str:
        """Its name, normalised."""
        return normalised(str(self.metadata["Name"]))

    @property
    def version(self) -> str:
        """Its version."""
        return str(self.metadata["Version"])

    def values(self, field: str) -> list[str]:
        """Return all values of a field of the metadata."""
        return [value.strip() for value in self.metadata.get_all(field, [])]

    @property
    def supplier(self) -> str:
        """Whom it is from: its maintainer, its author, or else who publishes it."""
        fields = ("Maintainer", "Author", "Maintainer-email", "Author-email")
        named = (value for field in fields for value in self.values(field) if value)
        # An address is nobody's business.
        return next((_ADDRESS.sub("", each).strip(' "') or each for each in named), _INDEX)

    def read(self, path: str) -> bytes:
        """Return a file of its record."""
        return (self.folder / path).read_bytes()


def read_distributions(folders: Iterable[Path]) -> list[Distribution]:
    """Read all distributions in some folders, each folder once, sorted by name."""
    unique = {folder.resolve(): None for folder in folders}
    found = [
        _read(info) for folder in unique for info in folder.glob("*.dist-info") if info.is_dir()
    ]
    return sorted(found, key=lambda each: (each.name, each.version))


def _read(info: Path) -> Distribution:
    # Of bytes, names of people with other letters than English ones would be lost.
    metadata = Parser().parsestr((info / "METADATA").read_text(encoding="utf-8"))
    lines = (info / "RECORD").read_text(encoding="utf-8").splitlines()
    record = {
        path.replace("\\", "/"): _hex(recorded)
        for path, recorded, *_ in csv.reader(lines)
        # Scripts lie outside of the folder and are never bundled.
        if not path.startswith("..")
    }
    return Distribution(info.parent, info.name, metadata, record)


def _hex(recorded: str) -> str | None:
    """Turn ``sha256=<base64>`` of a record into hex."""
    algorithm, _, digest = recorded.partition("=")
    if algorithm != "sha256":
        return None
    return base64.urlsafe_b64decode(digest + "=" * (-len(digest) % 4)).hex()
