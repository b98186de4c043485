"""Finds for everything in a bundle the component that it belongs to."""

from __future__ import annotations

import hashlib
import zipfile
from collections import defaultdict
from collections.abc import Iterable, Mapping
from pathlib import Path

from installer.bundle import cpython, known
from installer.bundle.archive import Archive, read_archive
from installer.bundle.binaries import is_microsofts
from installer.bundle.cpython import CPython
from installer.bundle.distributions import Distribution
from installer.bundle.errors import UnknownFileError
from installer.bundle.forbidden import refuse_forbidden
from installer.bundle.model import BundledFile, Holding
from installer.bundle.names import matches
from installer.layout import WINDOWED

_INTERNAL = "_internal/"
_LIBRARY = f"{_INTERNAL}base_library.zip"
_PROGRAM = f"{known.PROGRAM}.exe"
_PROGRAMS = (_PROGRAM, f"{WINDOWED}.exe")


def take_inventory(
    bundle: Path, paths: Iterable[str], distributions: Iterable[Distribution], python: CPython
) -> dict[str, Holding]:
    """Find the owner of each file and of each module in the archives.

    Parameters
    ----------
    bundle
        The bundle's folder, as PyInstaller made it.
    paths
        Its files, below the folder, with ``/``.
    distributions, python
        What it was made from.

    Returns
    -------
    dict of str to Holding
        What each component has, by the component's name. Where two distributions have the same
        module, both have it.

    Raises
    ------
    UnknownFileError
        If anything belongs to nothing; names each.
    ForbiddenFileError
        If the bundle holds what it must not.
    ArchiveError
        If the program cannot be read.
    """
    present = sorted(paths)
    archives = _archives(bundle)
    library = _library_modules(bundle / _LIBRARY)
    frozen = [name for archive in archives.values() for name in archive.modules]
    refuse_forbidden(bundle, present, (*frozen, *library))
    owners = _Owners(distributions, python)
    holdings: dict[str, Holding] = defaultdict(Holding)
    unknown = _assign_files(bundle, present, owners, holdings)
    for where, found in _modules(owners, archives, library).items():
        if not found:
            unknown.append(where)
        for owner in found:
            holdings[owner].modules.add(where.partition("!")[2])
    if unknown:
        message = (
            f"Nothing that the bundle was made from has {', '.join(sorted(unknown))}; find out "
            "where it is from and name that in installer/bundle/known.py, or exclude it."
        )
        raise UnknownFileError(message)
    return dict(holdings)


def _assign_files(
    bundle: Path, paths: Iterable[str], owners: _Owners, holdings: dict[str, Holding]
) -> list[str]:
    """Give each file to its owner; return those that have none."""
    unknown: list[str] = []
    for path in paths:
        content = (bundle / path).read_bytes()
        owner = owners.of_file(path, content)
        if owner is None:
            unknown.append(path)
        else:
            file = BundledFile(path, hashlib.sha256(content).hexdigest())
            holdings[owner].files.append(file)
    return unknown


def _archives(bundle: Path) -> Mapping[str, Archive]:
    """Read the programs, by the names of their files; the one without a console may be missing."""
    if not (bundle / _PROGRAM).is_file():
        message = f"{bundle} holds no {_PROGRAM}; name the folder that PyInstaller made."
        raise UnknownFileError(message)
    return {name: read_archive(bundle / name) for name in _PROGRAMS if (bundle / name).is_file()}


def _modules(
    owners: _Owners, archives: Mapping[str, Archive], library: Iterable[str]
) -> Mapping[str, tuple[str, ...]]:
    """Map ``file!module`` to its owners."""
    found: dict[str, tuple[str, ...]] = {}
    for file, archive in archives.items():
        found |= {f"{file}!{name}": owners.of_script(name) for name in archive.scripts}
        found |= {f"{file}!{name}": owners.of_module(name) for name in archive.modules}
    found |= {f"{_LIBRARY}!{name}": owners.of_module(name) for name in library}
    return found


def _library_modules(library: Path) -> tuple[str, ...]:
    """Name the modules in the archive that Python needs before it can read the other one."""
    if not library.is_file():
        return ()
    with zipfile.ZipFile(library) as archive:
        names = [name for name in archive.namelist() if not name.endswith("/")]
    # Anything but a module keeps its name, which will not be found.
    stems = (name.removesuffix(".pyc").removesuffix("/__init__") for name in names)
    return tuple(stem.replace("/", ".") for stem in stems)


class _Owners:
    """Who has what, by path, by content and by name."""

    def __init__(self, distributions: Iterable[Distribution], python: CPython) -> None:
        self._python = python
        self._by_path: dict[str, dict[str, str | None]] = defaultdict(dict)
        self._by_content: dict[str, str] = {}
        for distribution in distributions:
            for path, digest in distribution.record.items():
                self._by_path[path][distribution.name] = digest
                if digest is not None:
                    self._by_content.setdefault(digest, distribution.name)

    def of_file(self, path: str, content: bytes) -> str | None:
        """Return a file's owner; None if there is none."""
        if path in _PROGRAMS:
            return known.PRODUCT
        if path == _LIBRARY:
            return cpython.NAME
        if matches(path, known.VC_RUNTIME_FILES) and is_microsofts(content):
            return known.VC_RUNTIME
        digest = hashlib.sha256(content).hexdigest()
        at_path = self._by_path.get(path.removeprefix(_INTERNAL), {})
        same = (name for name, recorded in at_path.items() if recorded in {digest, None})
        owner = next(same, None)
        # Many packages have the same empty files.
        if owner is None and content:
            owner = self._by_content.get(digest)
            if owner is None and digest in self._python.binaries:
                owner = cpython.NAME
        return owner

    def of_module(self, name: str) -> tuple[str, ...]:
        """Return those who have a module; usually one."""
        path = name.replace(".", "/")
        folders = ("", *(f"{folder}/" for folder in known.RUNTIME_FOLDERS))
        owners = self._having(
            f"{folder}{path}{end}" for folder in folders for end in (".py", "/__init__.py")
        )
        if not owners and self._python.has_module(name):
            return (cpython.NAME,)
        return owners

    def of_script(self, name: str) -> tuple[str, ...]:
        """Return the owner of a script that the program runs at its start."""
        if name in known.PRODUCT_SCRIPTS:
            return (known.PRODUCT,)
        return self._having(f"{folder}/{name}.py" for folder in known.RUNTIME_FOLDERS)

    def _having(self, paths: Iterable[str]) -> tuple[str, ...]:
        return tuple(sorted({name for path in paths for name in self._by_path.get(path, ())}))
