"""Says what software a frozen bundle holds, and refuses what must not be in it."""

from installer.bundle.complete import complete as complete
from installer.bundle.errors import BundleError as BundleError
from installer.bundle.errors import ForbiddenFileError as ForbiddenFileError
from installer.bundle.errors import ForbiddenLicenceError as ForbiddenLicenceError
from installer.bundle.errors import UnknownFileError as UnknownFileError
