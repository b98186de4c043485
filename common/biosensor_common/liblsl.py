"""Finds liblsl where pylsl does not include it, and reports how to install it.

pylsl's Linux wheel includes it for x86-64 with glibc 2.35 or newer. On ARM, and with an older
glibc, pip installs the wheel without it.
"""

from __future__ import annotations

import platform
import sys
from collections.abc import Generator, Iterator, MutableMapping
from contextlib import contextmanager
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

VARIABLE = "PYLSL_LIB"
"""Environment variable from which pylsl takes the library's path."""
_BROUGHT = (("biosensor_liblsl", "liblsl.so"), ("mne_lsl", "lsl/lib/liblsl.so*"))
"""Packages with a library that is new enough: our own wheels for Linux, and mne-lsl."""
_GLIBC_OF_PYLSL, _GLIBC_OF_OTHERS = (2, 35), (2, 26)
_RELEASES = "https://github.com/sccn/liblsl/releases"


def provide(environment: MutableMapping[str, str]) -> None:
    """Set the variable for pylsl, here and in child processes, if another package has the library.

    A value that the user has set stays. The system's library is not used: it may be old.
    """
    if sys.platform != "linux" or environment.get(VARIABLE) or any(_files("pylsl", "lib/*lsl*.so")):
        return
    for package, pattern in _BROUGHT:
        for found in _files(package, pattern):
            environment[VARIABLE] = str(found)
            return


def what_is_missing(error: BaseException) -> str:
    """Return a sentence if the error means that pylsl found no liblsl, else an empty text."""
    trace = error.__traceback__
    while trace is not None and trace.tb_next is not None:
        trace = trace.tb_next
    if trace is None or trace.tb_frame.f_globals.get("__name__") != "pylsl.lib":
        return ""
    folder = next(_folders("pylsl"), Path())
    return (
        f"liblsl, the library of the Lab Streaming Layer, cannot be loaded: pylsl in {folder} has "
        f"none for this computer ({_system()}); {remedy()}"
    )


def is_missing() -> bool:
    """Whether pylsl cannot be used."""
    try:
        import_module("pylsl")
    except (ImportError, OSError, RuntimeError):
        return True
    return False


@contextmanager
def needed_by(program: str) -> Generator[None]:
    """Exit with one sentence if the code in the context finds no liblsl."""
    try:
        yield
    except (OSError, RuntimeError) as error:
        sentence = what_is_missing(error)
        if not sentence:
            raise
        sys.stderr.write(f"{program}: {sentence}\n")
        raise SystemExit(1) from None


def remedy(install_pylsl: str = "") -> str:
    """Return how to install the library.

    Parameters
    ----------
    install_pylsl
        Command that installs pylsl, for computers for which its wheel includes the library.
    """
    pip = f"{sys.executable} -m pip install"
    if sys.platform != "linux" or _brings(platform.machine() == "x86_64", _GLIBC_OF_PYLSL):
        return install_pylsl or f"run: {pip} --force-reinstall pylsl"
    own = f"set {VARIABLE} to a liblsl.so from {_RELEASES}, or build it"
    if _brings(platform.machine() in {"x86_64", "aarch64"}, _GLIBC_OF_OTHERS):
        return f"run: {pip} --no-deps mne-lsl, which includes one that is found; or {own}"
    return own


def _brings(has_wheels: bool, oldest: tuple[int, int]) -> bool:
    name, version = platform.libc_ver()
    numbers = tuple(int(each) for each in version.split(".")[:2] if each.isdigit())
    return has_wheels and name == "glibc" and numbers >= oldest


def _system() -> str:
    return " ".join(
        each for each in (sys.platform, platform.machine(), *platform.libc_ver()) if each
    )


def _files(package: str, pattern: str) -> Iterator[Path]:
    for folder in _folders(package):
        yield from sorted(folder.glob(pattern))


def _folders(package: str) -> Iterator[Path]:
    # Importing the package may take seconds, or may be what fails.
    found = find_spec(package)
    for folder in (found.submodule_search_locations if found else None) or ():
        yield Path(folder)
