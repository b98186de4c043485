"""Brings liblsl for the wheels for Linux: ``.uv/bin/python -m installer.liblsl FOLDER``.

pylsl's wheel for Linux holds it for x86-64 with a new glibc alone. mne-lsl's wheels hold it for
more; what they need is heavy, so that only the library is taken, by hash, with the licences of its
parts. The Python must have pip, which alone downloads for another processor.
"""

from __future__ import annotations

import argparse
import struct
import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path

from installer.layout import ROOT

PACKAGE = "biosensor_liblsl"
"""Where it is found: `biosensor_common.liblsl`."""
PROCESSORS = ("aarch64", "x86_64")
_LOCK = ROOT / "requirements" / "liblsl.txt"
_TEXTS = ROOT / "installer" / "bundle" / "texts"
_LICENCES = ("liblsl", "asio", "BSL-1.0", "loguru", "pugixml")
_ELF64, _PROGRAM_HEADERS, _SIZE_AND_COUNT = b"\x7fELF\x02\x01", 32, 54
_DYNAMIC, _NULL, _RPATHS = 2, 0, {15, 29}
_ENTRY = struct.Struct("<QQ")


def bring(processor: str, folder: Path) -> Path:
    """Put library and licences for a processor below a folder; return where they are."""
    target = folder / processor / PACKAGE
    target.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as downloads:
        subprocess.run([*_download(processor), "--dest", downloads], check=True)
        (wheel,) = Path(downloads).glob("*.whl")
        with zipfile.ZipFile(wheel) as archive:
            (name,) = (each for each in archive.namelist() if "/liblsl.so" in each)
            library = archive.read(name)
    (target / "liblsl.so").write_bytes(without_search_path(library))
    for each in _LICENCES:
        text = (_TEXTS / f"{each}.txt").read_text(encoding="utf-8")
        (target / f"LICENSE-{each}.txt").write_text(text, encoding="utf-8")
    return target


def _download(processor: str) -> list[str]:
    platforms = [f"--platform=manylinux_2_{minor}_{processor}" for minor in (28, 27, 26, 17)]
    return [
        *(sys.executable, "-m", "pip", "download", "--quiet", "--no-deps", "--only-binary=:all:"),
        *("--python-version=3.11", "--require-hashes", "--requirement", str(_LOCK)),
        *platforms,
    ]


def without_search_path(library: bytes) -> bytes:
    """Return a library that has libraries looked for where the system has them, and nowhere else.

    The search path of this one is of empty entries, and those mean the current folder.
    """
    if not library.startswith(_ELF64):
        raise ValueError("the library is not one of 64-bit Linux")
    content = bytearray(library)
    (headers,) = struct.unpack_from("<Q", content, _PROGRAM_HEADERS)
    size, count = struct.unpack_from("<HH", content, _SIZE_AND_COUNT)
    for header in range(headers, headers + size * count, size):
        kind, _flags, begin = struct.unpack_from("<IIQ", content, header)
        if kind != _DYNAMIC:
            continue
        (length,) = struct.unpack_from("<Q", content, header + 32)
        entries = [*_ENTRY.iter_unpack(content[begin : begin + length])]
        kept = [each for each in entries if each[0] not in _RPATHS]
        kept += [(_NULL, 0)] * (len(entries) - len(kept))
        content[begin : begin + length] = b"".join(_ENTRY.pack(*each) for each in kept)
    return bytes(content)


def main() -> None:
    """Bring it for each processor."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    folder: Path = parser.parse_args().folder
    for each in PROCESSORS:
        sys.stdout.write(f"{bring(each, folder).parent}\n")


if __name__ == "__main__":
    main()
