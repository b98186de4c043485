"""The built packages, and environments in which they are installed outside of any checkout."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
UV = ROOT / ".uv" / "bin" / "uv"
PROGRAM = "biosensor-gateway"
LOCK = ROOT / "requirements" / "gateway.txt"


def uv(
    *arguments: str | Path, folder: Path = ROOT, variables: Mapping[str, str] | None = None
) -> str:
    """Run uv, which must do what it is told."""
    done = subprocess.run(
        [UV, *arguments],
        capture_output=True,
        text=True,
        check=False,
        cwd=folder,
        env={**os.environ, "UV_SYSTEM_CERTS": "1", **(variables or {})},
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def build(
    source: Path, folder: Path, option: str, repository: str = "", liblsl: Path | None = None
) -> Path:
    """Build one package of a source, ``--wheel`` or ``--sdist``; return it."""
    known = {
        "REPOSITORY_URL": repository,
        "BIOSENSOR_GATEWAY_LIBLSL": "" if liblsl is None else str(liblsl),
    }
    uv("build", "--quiet", option, "--out-dir", folder, source, variables=known)
    (built,) = (each for each in folder.iterdir() if each.suffix in (".whl", ".gz"))
    return built


class Installed:
    """A wheel with what is locked, in an environment and a folder of their own.

    The program runs as that of a user who has just installed it: with nothing of this checkout,
    and a home folder that is empty.
    """

    def __init__(self, folder: Path, wheel: Path, python: str = sys.executable) -> None:
        self.folder, self.home = folder, folder / "home"
        self.home.mkdir(parents=True)
        self._environment = folder / "env"
        uv("venv", "--quiet", "--python", python, self._environment)
        self._install("--require-hashes", "-r", LOCK)
        self.upgrade(wheel)

    def upgrade(self, wheel: Path) -> None:
        self._install("--no-deps", "--reinstall", wheel)

    def _install(self, *what: str | Path) -> None:
        uv("pip", "install", "--quiet", "--python", self._environment / "bin" / "python", *what)

    def start(self, *arguments: str, program: str = PROGRAM) -> subprocess.Popen[str]:
        return subprocess.Popen(
            [self._environment / "bin" / program, *arguments],
            cwd=self.folder,
            env=users(self.home),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )

    def run(self, *arguments: str, codes: Sequence[int] = (0,), program: str = PROGRAM) -> str:
        """Run a command to its end; return what it has said."""
        process = self.start(*arguments, program=program)
        said, _ = process.communicate(timeout=170)
        assert "Traceback" not in said, said
        assert process.returncode in codes, said
        return said


def users(home: Path) -> dict[str, str]:
    """Return the variables of a user's terminal, and the LSL session of this test run."""
    return {
        "HOME": str(home),
        "PATH": "/usr/local/bin:/usr/bin:/bin",
        "LSLAPICFG": os.environ["LSLAPICFG"],
        "PYTHON_KEYRING_BACKEND": os.environ["PYTHON_KEYRING_BACKEND"],
        "BIOSENSOR_GATEWAY_BROADCAST": "127.0.0.1",
    }


@pytest.fixture(scope="session")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build(ROOT, tmp_path_factory.mktemp("wheel"), "--wheel")
