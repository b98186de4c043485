"""Components inside the binaries of others: from the wheels' own words, or as known."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import cast

from packageurl import PackageURL

from installer.bundle import known
from installer.bundle.binaries import file_version, version_by
from installer.bundle.distributions import Distribution
from installer.bundle.errors import UnknownLicenceError
from installer.bundle.expressions import normalise
from installer.bundle.licences import component_texts
from installer.bundle.model import BundledFile, Component, Text
from installer.bundle.names import base_name, matches

# How numpy's LICENSE.txt heads the licence of each library in the wheel.
_BUNDLED = re.compile(
    r"^Name: (?P<name>.+)\nFiles: (?P<files>.+)\n(?:Description: .+\n)?(?:Availability: .+\n)?"
    r"License: (?P<licence>.+)$",
    re.MULTILINE,
)


@dataclass(frozen=True, slots=True)
class Split:
    """What a component's files turned out to be: its own, and the parts."""

    own: tuple[BundledFile, ...]
    parts: tuple[Component, ...]


def split(
    bundle: Path,
    name: str,
    files: tuple[BundledFile, ...],
    texts: tuple[Text, ...] = (),
    distribution: Distribution | None = None,
) -> Split:
    """Find the parts of a component.

    Parameters
    ----------
    bundle
        The bundle's folder.
    name
        The component's name.
    files
        Its files in the bundle.
    texts
        Its licence texts; some name libraries in the wheel.
    distribution
        The distribution that it is, which may describe its parts (PEP 770).

    Returns
    -------
    Split
        A file that is nothing but a part is that part's alone.

    Raises
    ------
    MissingTextError, UnknownLicenceError
        If a part lacks its licence or the text of it.
    """
    found = [*_known_parts(bundle, name, files), *_parts_by_text(files, texts)]
    if distribution is not None and any(file.path.endswith(".pyd") for file in files):
        found += _parts_by_bom(distribution)
    theirs = {file for part in found for file in part.files}
    own = tuple(file for file in files if file not in theirs)
    return Split(own, tuple(sorted(found, key=lambda part: (part.name, part.version or ""))))


def _known_parts(bundle: Path, of: str, files: tuple[BundledFile, ...]) -> Iterator[Component]:
    for part in known.PARTS:
        within = tuple(file for file in files if matches(file.path, part.files))
        if part.of == of and within:
            contents = ((bundle / file.path).read_bytes() for file in within)
            versions = (_version(part, content) for content in contents)
            version = next((each for each in versions if each is not None), None)
            yield Component(
                part.name,
                version,
                PackageURL("generic", None, part.name, version).to_string(),
                part.licence,
                files=within if part.whole else (),
                texts=component_texts(part.name, part.licence),
            )


def _version(part: known.Part, content: bytes) -> str | None:
    if part.version is None and part.whole:
        return file_version(content)
    return version_by(part.version, content)


def _parts_by_text(files: tuple[BundledFile, ...], texts: tuple[Text, ...]) -> Iterator[Component]:
    """Read the heads of a licence text that says which libraries the wheel brings."""
    taken: set[BundledFile] = set()
    for text in texts:
        for head in _BUNDLED.finditer(text.content.decode("utf-8", "replace")):
            within = [file for file in files if matches(file.path, (base_name(head["files"]),))]
            if within:
                # The first is the library itself, those after it are linked into it.
                rest = tuple(file for file in within if file not in taken)
                taken.update(rest)
                purl = PackageURL("generic", None, head["name"].strip().lower().replace(" ", "-"))
                licence = normalise(head["licence"])
                yield Component(
                    head["name"].strip(), None, purl.to_string(), licence, rest, texts=(text,)
                )


def _parts_by_bom(distribution: Distribution) -> Iterator[Component]:
    """Read the bills of materials that a wheel brings."""
    for path in sorted(distribution.record):
        if path.startswith(f"{distribution.info}/sboms/") and path.endswith(".json"):
            bom = cast("dict[str, object]", json.loads(distribution.read(path)))
            for entry in cast("list[dict[str, object]]", bom.get("components", [])):
                # Excluded are tools of its build.
                if entry.get("scope") != "excluded":
                    yield _bom_component(entry, path)


def _bom_component(entry: dict[str, object], path: str) -> Component:
    name, version = str(entry["name"]), str(entry["version"])
    licence = known.LICENCES.get(name) or _bom_licence(entry)
    if licence is None:
        message = (
            f"{path} does not say which licence {name} {version} is under; "
            "look it up and name it in installer/bundle/known.py."
        )
        raise UnknownLicenceError(message)
    purl = PackageURL.from_string(str(entry["purl"]))
    bare = PackageURL(purl.type, purl.namespace, purl.name, purl.version)
    return Component(name, version, bare.to_string(), licence, texts=component_texts(name, licence))


def _bom_licence(entry: dict[str, object]) -> str | None:
    expressions: list[str] = []
    for each in cast("list[dict[str, object]]", entry.get("licenses", [])):
        licence = cast("dict[str, str]", each.get("license", {}))
        said = each.get("expression") or licence.get("id")
        if said is None:
            return None
        expressions.append(f"({said})")
    return normalise(" AND ".join(expressions)) if expressions else None
