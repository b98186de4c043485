"""Errors of a bundle."""

from __future__ import annotations


class BundleError(Exception):
    """The bundle must not be shipped as it is."""


class ArchiveError(BundleError):
    """A program is not one that PyInstaller froze, or its archive cannot be read."""


class UnknownFileError(BundleError):
    """Files or modules of the bundle belong to no component."""


class ForbiddenFileError(BundleError):
    """The bundle holds what must never be in it."""


class ForbiddenLicenceError(BundleError):
    """Components are under licences that this product must not be shipped with."""


class UnknownLicenceError(BundleError):
    """It cannot be told under which licence a component is."""


class MissingTextError(BundleError):
    """There is no licence text for a component."""
