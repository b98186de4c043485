"""Describes the components of a bundle, given what each has in it."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterable, Mapping
from pathlib import Path

from packageurl import PackageURL

from installer.bundle import cpython, known
from installer.bundle.binaries import file_version, version_by
from installer.bundle.cpython import CPython
from installer.bundle.distributions import Distribution
from installer.bundle.errors import ForbiddenLicenceError
from installer.bundle.expressions import declared, may_ship, normalise
from installer.bundle.licences import component_texts, cpython_texts, distribution_texts
from installer.bundle.model import BundledFile, Component, Holding
from installer.bundle.names import matches
from installer.bundle.needs import needs_on_windows
from installer.bundle.parts import split
from installer.layout import PUBLISHER

_CPYTHON_LICENCE = "PSF-2.0"
_NSIS_VERSION = re.compile(rb"Nullsoft Install System v(\d+\.[\d.]*\d)")
_CPYTHON_VERSION = re.compile(rb"\0(3\.\d+\.\d+)\0")


def describe(
    bundle: Path,
    holdings: Mapping[str, Holding],
    distributions: Iterable[Distribution],
    python: CPython,
) -> list[Component]:
    """Describe every component that has something in a bundle.

    Parameters
    ----------
    bundle
        The bundle's folder.
    holdings
        What each has, by its name.
    distributions, python
        What the bundle was made from.

    Returns
    -------
    list of Component
        Sorted by name.

    Raises
    ------
    ForbiddenLicenceError
        If components are under licences that must not be shipped; names each.
    MissingTextError, UnknownLicenceError
        If one lacks its licence or the text of it.
    """
    described: list[Component] = []
    version = None
    if cpython.NAME in holdings:
        interpreter = _cpython(bundle, holdings[cpython.NAME], known.VC_RUNTIME in holdings, python)
        version = interpreter.version
        described.append(interpreter)
    if known.VC_RUNTIME in holdings:
        described.append(_vc_runtime(bundle, holdings[known.VC_RUNTIME]))
    bundled = [each for each in distributions if each.name in holdings]
    names = frozenset(each.name for each in bundled)
    interpreters = {cpython.NAME} & holdings.keys()
    for each in bundled:
        needs = {*needs_on_windows(each, names, version), *_frozen_in(each.name, names)}
        needs |= interpreters
        described.append(_distribution(bundle, each, holdings[each.name], needs))
    described.sort(key=lambda component: component.name)
    _refuse_copyleft(described)
    return described


def _files(holding: Holding) -> tuple[BundledFile, ...]:
    return tuple(sorted(holding.files))


def _distribution(
    bundle: Path, distribution: Distribution, holding: Holding, needs: set[str]
) -> Component:
    name, version = distribution.name, distribution.version
    licence = normalise(known.LICENCES.get(name) or declared(distribution))
    texts = distribution_texts(distribution, licence)
    found = split(bundle, name, _files(holding), texts, distribution)
    return Component(
        name,
        version,
        PackageURL("pypi", None, name, version).to_string(),
        licence,
        files=found.own,
        modules=tuple(sorted(holding.modules)),
        texts=texts,
        parts=found.parts,
        needs=tuple(sorted(needs)),
        note=known.NOTES.get(name, ""),
        supplier=PUBLISHER if name == known.PRODUCT else distribution.supplier,
    )


def _frozen_in(name: str, bundled: frozenset[str]) -> frozenset[str]:
    """Name what the program holds though nobody requires it."""
    return bundled & {known.PYINSTALLER, known.HOOKS} if name == known.PRODUCT else frozenset()


def _cpython(bundle: Path, holding: Holding, has_runtime: bool, python: CPython) -> Component:
    files = _files(holding)
    contents = (
        (bundle / file.path).read_bytes() for file in files if matches(file.path, ("python3*.dll",))
    )
    versions = (version_by(_CPYTHON_VERSION, content) for content in contents)
    version = next((each for each in versions if each is not None), None)
    found = split(bundle, cpython.NAME, files)
    return Component(
        cpython.NAME,
        version,
        PackageURL("generic", None, cpython.NAME, version).to_string(),
        _CPYTHON_LICENCE,
        files=found.own,
        modules=tuple(sorted(holding.modules)),
        texts=cpython_texts(python),
        parts=found.parts,
        needs=(known.VC_RUNTIME,) if has_runtime else (),
        supplier=known.SUPPLIERS[cpython.NAME],
    )


def _vc_runtime(bundle: Path, holding: Holding) -> Component:
    name, files = known.VC_RUNTIME, _files(holding)
    versions = (file_version((bundle / file.path).read_bytes()) for file in files)
    version = max(
        (each for each in versions if each is not None),
        key=lambda each: [int(number) for number in each.split(".")],
        default=None,
    )
    purl = PackageURL("generic", None, name, version).to_string()
    texts = component_texts(name, known.VC_RUNTIME_LICENCE)
    note = known.NOTES[name]
    return Component(
        name,
        version,
        purl,
        known.VC_RUNTIME_LICENCE,
        files,
        texts=texts,
        note=note,
        supplier=known.SUPPLIERS[name],
    )


def uninstaller(program: Path) -> Component:
    """Describe the uninstaller, which is NSIS's with the script of ours.

    Parameters
    ----------
    program
        As NSIS made it; it is installed under the same name.

    Raises
    ------
    MissingTextError, UnknownLicenceError
        If its licence, or the text of it, is not known.
    """
    content, name = program.read_bytes(), known.NSIS
    version = version_by(_NSIS_VERSION, content)
    return Component(
        name,
        version,
        PackageURL("generic", None, name, version).to_string(),
        known.NSIS_LICENCE,
        files=(BundledFile(program.name, hashlib.sha256(content).hexdigest()),),
        texts=component_texts(name, known.NSIS_LICENCE),
        supplier=known.SUPPLIERS[name],
    )


def _refuse_copyleft(components: Iterable[Component]) -> None:
    found = [
        f"{each.name} ({each.licence})"
        for component in components
        for each in (component, *component.parts)
        if not may_ship(each.licence)
    ]
    if found:
        message = (
            f"The bundle must not hold {', '.join(found)}: the licence puts terms on what is "
            "shipped with it; exclude it where it is frozen."
        )
        raise ForbiddenLicenceError(message)
