"""On which version of the project tests run."""

from __future__ import annotations

import hashlib
import subprocess
from dataclasses import dataclass
from pathlib import Path

from tests.nightly.parts import ROOT


@dataclass(frozen=True)
class Version:
    """A commit, and which files differ from it."""

    commit: str
    title: str
    changed: tuple[str, ...]
    key: str
    """Names the folder of the results: changed files are another version."""

    @property
    def seed(self) -> int:
        """A number that is another one for each commit."""
        return int(self.commit[:7], 16)


def version(root: Path = ROOT) -> Version:
    """Ask git; raises ``CalledProcessError`` where there is no commit."""
    commit, title = _git(root, "log", "-1", "--format=%H%n%s").splitlines()
    changed = _git(root, "status", "--porcelain")
    key = commit[:12]
    if changed:
        difference = hashlib.sha256((changed + _git(root, "diff", "HEAD")).encode())
        for file in _git(root, "ls-files", "--others", "--exclude-standard").splitlines():
            if (root / file).is_file():
                difference.update((root / file).read_bytes())
        key += f"-changed-{difference.hexdigest()[:8]}"
    return Version(commit, title, tuple(changed.splitlines()), key)


def _git(root: Path, *arguments: str) -> str:
    command = ["git", "-c", "core.quotePath=false", *arguments]
    asked = subprocess.run(
        command, cwd=root, check=True, stdout=subprocess.PIPE, encoding="utf-8", errors="replace"
    )
    return asked.stdout
