"""Completes a bundle from the command line, as ``build.ps1`` does it."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from pathlib import Path

from installer.bundle.complete import complete
from installer.bundle.errors import BundleError
from installer.layout import TIME_VARIABLE, source_time

_FOLDERS = {
    "bundle": "the folder that PyInstaller made",
    "packages": "where the Python packages are installed that it was made from",
    "python": "the Windows CPython that it was made with",
    "product": "where the product itself is installed",
    "out": "gets licenses/ and sbom.cdx.json",
}
_PARTS = {
    "documents": "the folder of pages that is installed as docs",
    "uninstaller": "the program that removes all that is installed",
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Complete a bundle; return 1, with one sentence, if it must not be shipped."""
    os.environ.setdefault(TIME_VARIABLE, source_time())
    parser = argparse.ArgumentParser(prog="python -m installer.bundle", description=__doc__)
    for name, meaning in _FOLDERS.items():
        parser.add_argument(f"--{name}", type=Path, required=True, metavar="FOLDER", help=meaning)
    parser.add_argument("--below", default="", help="folder of the installation that it becomes")
    for name, meaning in _PARTS.items():
        parser.add_argument(f"--{name}", type=Path, help=meaning)
    try:
        complete(**vars(parser.parse_args(arguments)))
    except BundleError as error:
        sys.stderr.write(f"{error}\n")
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
