"""A build of named stages; what has not changed is not made again.

A stage is done when its folder holds the fingerprint of all that goes into it: its
own inputs and the fingerprints of the stages before it.
"""

from __future__ import annotations

import hashlib
import shutil
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

STAMP = ".fingerprint"


@dataclass(frozen=True, slots=True)
class Stage:
    """One step of the build."""

    name: str  # Also the name of its folder.
    make: Callable[[Path], None]  # Fills the folder, which is empty then.
    # Files and folders that it reads, besides what earlier stages made.
    inputs: tuple[Path, ...] = ()
    after: tuple[Stage, ...] = ()  # Earlier stages that it builds on.


class Build:
    """Makes stages below one folder.

    Parameters
    ----------
    work
        Has a folder for each stage.
    say
        Called once per stage with its name and outcome.
    """

    def __init__(self, work: Path, say: Callable[[str], None] = print) -> None:
        self._work = work
        self._say = say
        self._fingerprints: dict[str, str] = {}

    def folder(self, stage: Stage) -> Path:
        """Where a stage has put what it made."""
        return self._work / stage.name

    def bring_up_to_date(self, stage: Stage) -> Path:
        """Make a stage and those before it, as far as they changed; return its folder."""
        for earlier in stage.after:
            self.bring_up_to_date(earlier)
        folder = self.folder(stage)
        if stage.name in self._fingerprints:
            return folder
        wanted = self._fingerprint(stage)
        stamp = folder / STAMP
        if not (stamp.is_file() and stamp.read_text(encoding="ascii") == wanted):
            began = time.monotonic()
            shutil.rmtree(folder, ignore_errors=True)
            folder.mkdir(parents=True)
            stage.make(folder)
            stamp.write_text(wanted, encoding="ascii")
            self._say(f"{stage.name}: made in {time.monotonic() - began:.0f} s")
        else:
            self._say(f"{stage.name}: unchanged")
        self._fingerprints[stage.name] = wanted
        return folder

    def _fingerprint(self, stage: Stage) -> str:
        digest = hashlib.sha256(stage.name.encode())
        for earlier in stage.after:
            digest.update(self._fingerprints[earlier.name].encode())
        for path in _files(stage.inputs):
            digest.update(str(path).encode())
            digest.update(path.read_bytes())
        return digest.hexdigest()


def _files(inputs: Iterable[Path]) -> Iterable[Path]:
    for path in inputs:
        if path.is_dir():
            found = (each for each in path.rglob("*") if each.is_file())
            yield from sorted(each for each in found if "__pycache__" not in each.parts)
        else:
            yield path
