"""A Python with ROS and colcon in which this project is not installed, to build it in."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path

ROOT = Path(__file__).parents[2]
UV = ROOT / ".uv" / "bin" / "uv"
# colcon needs an older setuptools than the messages' lock has, so it comes last.
LOCKS = ("ros.txt", "colcon.txt")
# The first test of a run waits for downloads and compilers.
BUILD_TIMEOUT_S = 900
# The ROS wheels restart python once with their libraries' path and mark that in the
# environment: inherited, a python of another environment would load our libraries.
OF_OUR_ENVIRONMENT = (
    "_ROS_WHEELS_BOOTSTRAP_COMPLETE",
    "LD_LIBRARY_PATH",
    "PYTHONPATH",
    "AMENT_PREFIX_PATH",
    "CMAKE_PREFIX_PATH",
    "COLCON_PREFIX_PATH",
    "VIRTUAL_ENV",
)
# Program: the Debian package that has it.
BUILD_TOOLS = {
    "bash": "bash",
    "c++": "g++",
    "cc": "gcc",
    "cmake": "cmake",
    "git": "git",
    "make": "make",
}
# Where the wheels were built, which their CMake files still name.
_PYTHON_HEADERS = re.compile(r"/opt/python/[^/\s;\"]+/include/python3\.\d+")
_NUMPY_HEADERS = re.compile(
    r"/opt/python/[^/\s;\"]+/lib/python3\.\d+/site-packages/numpy/_core/include"
)


class BuildToolMissingError(Exception):
    """Something that compiling the messages takes is not on this machine."""


def require_build_tools(path: str | None = None, headers: Path | None = None) -> None:
    """Look for the programs and headers that colcon needs here.

    Parameters
    ----------
    path : str, optional
        Folders to search, as in ``PATH``; default: that of this process.
    headers : Path, optional
        Folder of Python's C headers; default: that of this interpreter.

    Raises
    ------
    BuildToolMissingError
        If one is not there; the sentence says which, and what to install.
    """
    missing = {name: package for name, package in BUILD_TOOLS.items() if not _found(name, path)}
    header = (headers or Path(sysconfig.get_path("include"))) / "Python.h"
    if not header.is_file():
        missing[str(header)] = "python3-dev"
    if missing:
        raise BuildToolMissingError(
            f"colcon cannot build the ROS packages without {', '.join(missing)}:"
            f" install {' '.join(missing.values())} (Debian's names)."
        )


def _found(program: str, path: str | None) -> bool:
    return shutil.which(program, path=path) is not None


class Toolchain:
    """A virtual environment made from the locks.

    Parameters
    ----------
    folder
        Of the environment.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    @classmethod
    def install(cls, folder: Path) -> Toolchain:
        """Make the environment in a new *folder*.

        Raises
        ------
        BuildToolMissingError
            If the machine has no compiler, CMake or the like.
        """
        require_build_tools()
        made = cls(folder)
        if UV.exists():
            install = (str(UV), "pip", "install", "--quiet", "--python", made.python)
            made.run(ROOT, str(UV), "venv", "--quiet", "--python", sys.executable, str(folder))
        else:
            install = (made.python, "-m", "pip", "install", "--quiet")
            made.run(ROOT, sys.executable, "-m", "venv", str(folder))
        for lock in LOCKS:
            made.run(ROOT, *install, "--require-hashes", "-r", f"requirements/{lock}")
        numpy = "import numpy; print(numpy.get_include())"
        fix_header_paths(
            folder,
            python=sysconfig.get_path("include"),
            numpy=made.run(ROOT, made.python, "-c", numpy).strip(),
        )
        return made

    @property
    def python(self) -> str:
        """Path of the interpreter."""
        return str(self.folder / "bin" / "python")

    def environment(self) -> dict[str, str]:
        """Variables of a shell in which ROS is there, but no built workspace."""
        inherited = {k: v for k, v in os.environ.items() if k not in OF_OUR_ENVIRONMENT}
        return inherited | {
            "PATH": f"{self.folder / 'bin'}{os.pathsep}{os.environ['PATH']}",
            "COLCON_HOME": str(self.folder / "colcon"),
            # As requirements/install.sh has it.
            "UV_SYSTEM_CERTS": "1",
        }

    def build(self, folder: Path, *options: str) -> None:
        """Run ``colcon build`` in a workspace.

        Raises
        ------
        AssertionError
            If it failed; with all that it said.
        """
        # What the setup file of a ROS install says; the wheels have none.
        self.run(folder, "env", f"AMENT_PREFIX_PATH={self.folder}", "colcon", "build", *options)

    def run(self, folder: Path, *command: str) -> str:
        """Run a program to its end; return what it printed.

        Raises
        ------
        AssertionError
            If it failed; with all that it said.
        """
        result = subprocess.run(
            command,
            cwd=folder,
            env=self.environment(),
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            check=False,
        )
        assert result.returncode == 0, f"{command}\n{result.stdout}{result.stderr}"
        return result.stdout


def fix_header_paths(folder: Path, *, python: str, numpy: str) -> None:
    """Let the wheels' CMake files name this machine's headers of Python and numpy.

    Parameters
    ----------
    folder
        Of the environment that holds the wheels.
    python, numpy
        Folders of the headers.
    """
    for place in (folder / "share", folder / "lib" / "cmake"):
        for file in place.rglob("*.cmake"):
            text = file.read_text()
            fixed = _PYTHON_HEADERS.sub(lambda _: python, text)
            fixed = _NUMPY_HEADERS.sub(lambda _: numpy, fixed)
            if fixed != text:
                # The file may be a hard link into the installer's cache.
                file.unlink()
                file.write_text(fixed)
