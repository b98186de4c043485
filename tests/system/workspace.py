"""This repository as a ROS workspace in which colcon has built."""

from __future__ import annotations

import os
import shutil
import subprocess
from functools import cached_property
from pathlib import Path

from tests.system.toolchain import ROOT, Toolchain


class Workspace:
    """A copy of this repository with its ``install`` folder.

    Parameters
    ----------
    folder
        Of the copy.
    linked
        Whether the install folder holds links to the sources.
    """

    def __init__(self, folder: Path, toolchain: Toolchain, *, linked: bool) -> None:
        self.folder = folder
        self.toolchain = toolchain
        self.linked = linked

    @classmethod
    def build(cls, folder: Path, toolchain: Toolchain, *, linked: bool = False) -> Workspace:
        """Copy this repository into *folder* and build all of its ROS packages."""
        copy_repository(folder)
        toolchain.build(folder, *(["--symlink-install"] if linked else []))
        return cls(folder, toolchain, linked=linked)

    @property
    def install(self) -> Path:
        """Folder that colcon has installed into."""
        return self.folder / "install"

    @property
    def python(self) -> str:
        """Path of the interpreter that the packages were built for."""
        return self.toolchain.python

    @property
    def node(self) -> str:
        """Path of the installed node ``lsl_to_ros``."""
        return str(self.install / "lsl_to_ros" / "lib" / "lsl_to_ros" / "lsl_to_ros")

    def command(self, *words: str) -> list[str]:
        """Give a command as a person would: source the workspace first.

        It wants the variables of the toolchain, not of :meth:`environment`, and runs
        in the process of the shell, which a signal so reaches.
        """
        source = '. "$0" && exec "$@"'
        return ["bash", "-c", source, str(self.install / "setup.bash"), *words]

    def program(self, module: str, *arguments: str) -> list[str]:
        """Give the command of a Python module, for a process in :meth:`environment`."""
        return [self.python, "-m", module, *arguments]

    def environment(self) -> dict[str, str]:
        """Variables of a process that uses the workspace.

        Its Python finds what colcon has built, rclpy, pylsl and numpy, and the programs
        of the tests (``python -m tests.system.subscriber``), but nothing else of this
        repository.
        """
        return dict(self._environment)

    @cached_property
    def _environment(self) -> dict[str, str]:
        listing = self.toolchain.run(self.folder, *self.command("env", "-0"))
        sourced = dict(entry.split("=", 1) for entry in listing.rstrip("\0").split("\0"))
        return sourced | {"PYTHONPATH": f"{sourced['PYTHONPATH']}{os.pathsep}{ROOT}"}


def copy_repository(target: Path) -> None:
    """Copy what git tracks, or would track, with its changes."""
    listing = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    names = subprocess.run(listing, cwd=ROOT, stdout=subprocess.PIPE, check=True).stdout
    for name in os.fsdecode(names).rstrip("\0").split("\0"):
        # A tracked file may have been deleted.
        if (ROOT / name).is_file():
            (target / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, target / name)
