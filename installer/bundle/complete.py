"""Adds to a bundle what it must say about the software in it."""

from __future__ import annotations

import hashlib
import shutil
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path

from installer.bundle import known
from installer.bundle.components import describe
from installer.bundle.components import uninstaller as describe_uninstaller
from installer.bundle.cpython import CPython
from installer.bundle.distributions import read_distributions
from installer.bundle.errors import UnknownFileError
from installer.bundle.inventory import take_inventory
from installer.bundle.model import BundledFile, Component, Text
from installer.bundle.sbom import FILE_NAME, write_sbom
from installer.stages import STAMP

LICENCES = "licenses"
DOCUMENTS = "docs"


def complete(
    bundle: Path,
    packages: Path,
    python: Path,
    product: Path,
    out: Path,
    *,
    below: str = "",
    documents: Path | None = None,
    uninstaller: Path | None = None,
) -> None:
    """Write the licence texts and the bill of materials of a bundle.

    Parameters
    ----------
    bundle
        The folder that PyInstaller made; it has the program and ``_internal``.
    packages, product
        Where the Python packages that it was made from, and the product itself, are installed;
        may be the same folder.
    python
        The Windows CPython that it was made with.
    out
        Gets ``licenses/`` and ``sbom.cdx.json``; made if it is missing, and may be the bundle
        itself. What an earlier run wrote there is replaced.
    below
        Folder of the installation in which the bundle is; empty for the installation itself.
    documents
        The pages that are installed as ``docs``.
    uninstaller
        The program that is installed to remove all others.

    Raises
    ------
    BundleError
        If the bundle must not be shipped; a subclass for each reason. Then nothing is written.
    """
    distributions = read_distributions((packages, product))
    interpreter = CPython(python)
    holdings = take_inventory(bundle, _made_by_freezing(bundle), distributions, interpreter)
    components = describe(bundle, holdings, distributions, interpreter)
    components = [_moved(each, below) for each in components]
    if uninstaller is not None:
        components.append(describe_uninstaller(uninstaller))
    ours, others = _apart(components, product)
    texts = {text.path: text for text in _all_texts(components)}
    _write_texts(out, texts.values())
    written = [
        BundledFile(f"{LICENCES}/{path}", hashlib.sha256(text.content).hexdigest())
        for path, text in sorted(texts.items())
    ]
    written += _documents(documents)
    (out / FILE_NAME).write_bytes(write_sbom(ours, others, written))


def _moved(component: Component, below: str) -> Component:
    """Return a component whose files are in a folder of the installation."""
    files = tuple(BundledFile(f"{below}/{each.path}", each.sha256) for each in component.files)
    parts = tuple(_moved(each, below) for each in component.parts)
    return replace(component, files=files, parts=parts) if below else component


def _documents(folder: Path | None) -> list[BundledFile]:
    if folder is None:
        return []
    paths = sorted(path for path in folder.rglob("*") if path.is_file())
    return [
        BundledFile(
            f"{DOCUMENTS}/{path.relative_to(folder).as_posix()}",
            hashlib.sha256(path.read_bytes()).hexdigest(),
        )
        for path in paths
        if path.name != STAMP
    ]


def _made_by_freezing(bundle: Path) -> list[str]:
    """List a bundle's files but those that this module writes."""
    paths = (path.relative_to(bundle) for path in bundle.rglob("*") if path.is_file())
    return [
        path.as_posix() for path in paths if path.parts[0] != LICENCES and str(path) != FILE_NAME
    ]


def _apart(components: list[Component], product: Path) -> tuple[Component, list[Component]]:
    found = [each for each in components if each.name == known.PRODUCT]
    if not found:
        message = f"{product} does not hold {known.PRODUCT}; install the product there."
        raise UnknownFileError(message)
    return found[0], [each for each in components if each is not found[0]]


def _all_texts(components: Iterable[Component]) -> Iterator[Text]:
    for component in components:
        yield from component.texts
        yield from _all_texts(component.parts)


def _write_texts(out: Path, texts: Iterable[Text]) -> None:
    shutil.rmtree(out / LICENCES, ignore_errors=True)
    out.mkdir(parents=True, exist_ok=True)
    for text in texts:
        path = out / LICENCES / text.path
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(text.content)
