"""Finds what a distribution requires on 64-bit Windows."""

from __future__ import annotations

from collections.abc import Iterator

from packaging.requirements import Requirement

from installer.bundle import known
from installer.bundle.distributions import Distribution
from installer.bundle.names import normalised

# What markers ask for (PEP 508), as the Windows CPython answers.
_WINDOWS = {
    "implementation_name": "cpython",
    "os_name": "nt",
    "platform_machine": "AMD64",
    "platform_python_implementation": "CPython",
    "platform_system": "Windows",
    "sys_platform": "win32",
}


def needs_on_windows(
    distribution: Distribution, bundled: frozenset[str], python: str | None
) -> tuple[str, ...]:
    """Name what a distribution requires and the bundle has.

    Parameters
    ----------
    distribution
        Whose requirements.
    bundled
        Normalised names of the distributions in the bundle.
    python
        Version of the Python in it; None if it has none.

    Returns
    -------
    tuple of str
        Normalised names, sorted. Of the product its extras count too, as far as they are
        in the bundle; it is installed with those that it is frozen with.
    """
    environment = dict(_WINDOWS)
    if python is not None:
        environment["python_full_version"] = environment["implementation_version"] = python
        environment["python_version"] = ".".join(python.split(".")[:2])
    extras = [""]
    if distribution.name == known.PRODUCT:
        extras += distribution.values("Provides-Extra")
    needed = {
        normalised(requirement.name)
        for requirement in _requirements(distribution)
        if any(_applies(requirement, environment, extra) for extra in extras)
    }
    return tuple(sorted(needed & bundled))


def _requirements(distribution: Distribution) -> Iterator[Requirement]:
    return (Requirement(line) for line in distribution.values("Requires-Dist"))


def _applies(requirement: Requirement, environment: dict[str, str], extra: str) -> bool:
    marker = requirement.marker
    return marker is None or marker.evaluate({**environment, "extra": extra})
