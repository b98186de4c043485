"""The images, built without a registry on Debian from its packages, and commands in them."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Generator, Mapping
from contextlib import closing
from pathlib import Path

import pytest

from tests.wheel.arm64 import mirror

ROOT = Path(__file__).parents[2]
RELEASE = "bookworm"
PACKAGES = "python3,python3-venv,ca-certificates"
CERTIFICATES = Path("/etc/ssl/certs/ca-certificates.crt")
BASE = "localhost/debian-python"
LIMIT_S = 1500.0


def needs() -> str:
    """Say what is missing here; empty if nothing is."""
    if os.uname().machine != "x86_64":
        return "the images are for x86-64"
    if os.geteuid() != 0:
        return "only root can make a Debian in a folder"
    missing = [each for each in ("mmdebstrap", "buildah", "crun") if shutil.which(each) is None]
    return f"{', '.join(missing)} is missing" if missing else ""


class Engine:
    """buildah with its images in a folder, without a daemon and without a registry.

    They share the network of the computer, as they do with ``--network host``.
    """

    def __init__(self, folder: Path) -> None:
        self._variables = os.environ | {
            "BUILDAH_ISOLATION": "chroot",
            "STORAGE_DRIVER": "vfs",
            "XDG_RUNTIME_DIR": str(folder / "run"),
        }
        self._started: list[subprocess.Popen[str]] = []
        self._where = ("--root", folder / "storage", "--runroot", folder / "run")

    def command(self, *arguments: str | Path) -> list[str]:
        """Return what runs buildah with these arguments."""
        return [str(each) for each in ("buildah", *self._where, *arguments)]

    def run(self, *arguments: str | Path) -> str:
        """Run buildah, which must do what it is told; return what it has said."""
        done = subprocess.run(
            self.command(*arguments),
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            check=False,
            env=self._variables,
            timeout=LIMIT_S,
        )
        assert done.returncode == 0, done.stdout
        return done.stdout

    def make(self, target: str, base: str) -> None:
        """Run the recipe of `make containers`."""
        engine = " ".join(self.command())
        proxied = f"--volume {CERTIFICATES}:{CERTIFICATES}:ro"
        done = subprocess.run(
            ["make", target, f"ENGINE={engine}", f"BASE={base}", f"OPTIONS={proxied}"],
            cwd=ROOT,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            check=False,
            env=self._variables,
            timeout=LIMIT_S,
        )
        assert done.returncode == 0, done.stdout

    def start(
        self, container: str, *arguments: str, variables: Mapping[str, str]
    ) -> subprocess.Popen[str]:
        """Start a program in a container."""
        known = [f"--env={name}={value}" for name, value in variables.items()]
        started = subprocess.Popen(
            self.command("run", *known, container, "--", *arguments),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            env=self._variables,
        )
        self._started.append(started)
        return started

    def close(self) -> None:
        """End what still runs."""
        for each in self._started:
            each.terminate()
        for each in self._started:
            each.communicate(timeout=60)


@pytest.fixture(scope="session")
def engine(tmp_path_factory: pytest.TempPathFactory) -> Generator[Engine]:
    """With both images."""
    folder = tmp_path_factory.mktemp("containers")
    engine, base = Engine(folder), folder / "base.tar"
    subprocess.run(
        [
            *("mmdebstrap", "--quiet", "--variant=minbase", f"--include={PACKAGES}"),
            *(RELEASE, base, mirror()),
        ],
        check=True,
        timeout=LIMIT_S,
    )
    made = engine.run("from", "scratch").split()[-1]
    engine.run("add", made, base)
    engine.run("commit", "--quiet", made, BASE)
    engine.run("rm", made)
    base.unlink()
    engine.make("containers", BASE)
    with closing(engine):
        yield engine
    shutil.rmtree(folder)
