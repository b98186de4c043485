"""``python -m installer.portable BUNDLE ZIP``: the program without an installer."""

from __future__ import annotations

import sys
import zipfile
from pathlib import Path

from installer.layout import PROGRAM, version

# The earliest that a ZIP can tell: the same bundle gives the same archive.
_TIME = (1980, 1, 1, 0, 0, 0)


def main() -> None:
    """Write the archive."""
    pack(Path(sys.argv[1]), Path(sys.argv[2]))


def pack(bundle: Path, archive: Path) -> None:
    """Write all files of a bundle into an archive, below one folder with name and version."""
    top = f"{PROGRAM}-{version()}"
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as packed:
        for path in sorted(each for each in bundle.rglob("*") if each.is_file()):
            entry = zipfile.ZipInfo(f"{top}/{path.relative_to(bundle).as_posix()}", _TIME)
            entry.compress_type = zipfile.ZIP_DEFLATED
            packed.writestr(entry, path.read_bytes())


if __name__ == "__main__":
    main()
