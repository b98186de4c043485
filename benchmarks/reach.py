"""From nothing to traces: ``python -m benchmarks.reach [--debian RELEASE:PYTHON...]``.

Installs the wheel as users do, each way and with each Python that is here, with an empty home and
empty caches, and starts ``try``. Prints a table of seconds, and the sizes of what was built. Needs
a network; for Debian in a folder also root and mmdebstrap.
"""

from __future__ import annotations

import argparse
import os
import platform
import shutil
import subprocess
import tempfile
import time
import uuid
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from benchmarks.processes import BenchError
from tests.wheel.arm64 import mirror
from tests.wheel.conftest import ROOT, UV, build

PYTHONS = ("3.11", "3.12", "3.13", "3.14")
TRACES = "sensors stream"
_TRY = ("try", "--no-open", "--seconds", "3")
_INHERITED = ("SSL_CERT_FILE", "PIP_CERT", "UV_SYSTEM_CERTS")
_BUILT = ("dist/*-setup.exe", "dist/*-portable.zip")
_IN_DEBIAN = "python{0},python{0}-venv,ca-certificates"


class Place(NamedTuple):
    """Where a wheel is installed."""

    system: str
    python: str
    inside: Sequence[str] = ()  # The command that runs another one there.
    root: Path = Path("/")  # Its root folder, seen from here.


class Took(NamedTuple):
    """Seconds of a way: to install, and from the start of the program to the first traces."""

    install_s: float
    traces_s: float


def _call(command: Sequence[str | Path], variables: Mapping[str, str]) -> float:
    begin_s = time.monotonic()
    done = subprocess.run(
        command,
        env={**variables},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=False,
    )
    if done.returncode:
        raise BenchError(f"{command[0]} failed: {done.stdout[-2000:]}")
    return time.monotonic() - begin_s


def _until_traces(command: Sequence[str | Path], variables: Mapping[str, str]) -> float:
    """Run ``try`` to its end; return when its sensors streamed."""
    begin_s, traces_s, said = time.monotonic(), None, ""
    with subprocess.Popen(
        [*command, *_TRY],
        env={**variables},
        cwd=variables["HOME"] if Path(variables["HOME"]).is_dir() else None,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    ) as process:
        assert process.stdout is not None
        for line in process.stdout:
            said += line
            if TRACES in line:
                traces_s = time.monotonic() - begin_s
    if process.returncode or traces_s is None:
        raise BenchError(f"try has failed: {said[-2000:]}")
    return traces_s


def _ways(place: Place, wheel: Path, folder: Path) -> Iterator[tuple[str, Took]]:
    """Install and try; what the programs write is in the folder, as seen there."""
    there = Path("/") / folder.relative_to(place.root)
    wheel_there = there / wheel.name
    shutil.copy(wheel, folder)
    config = folder / "lsl.cfg"
    config.write_text(f"[lab]\nSessionID = {uuid.uuid4().hex}\n", encoding="utf-8")
    variables = {name: os.environ[name] for name in _INHERITED if name in os.environ}
    variables |= {
        "HOME": str(there),
        "PATH": "/usr/local/bin:/usr/bin:/bin",
        "LSLAPICFG": str(there / config.name),
        "PIP_NO_CACHE_DIR": "1",
        "UV_CACHE_DIR": str(there / "cache"),
        "UV_SYSTEM_CERTS": "1",
        "PIPX_HOME": str(there / "pipx"),
        "PIPX_BIN_DIR": str(there / "bin"),
        "BIOSENSOR_GATEWAY_BROADCAST": "127.0.0.1",
    }
    program = "biosensor-gateway"
    environment = there / "env"
    install_s = _call([*place.inside, place.python, "-m", "venv", environment], variables)
    pip = [*place.inside, environment / "bin" / "pip", "install", "--quiet", wheel_there]
    install_s += _call(pip, variables)
    yield (
        "`pip install`",
        Took(install_s, _until_traces([*place.inside, environment / "bin" / program], variables)),
    )
    if place.inside:
        return
    uvx = [UV, "tool", "run", "--python", place.python, "--from", wheel_there, program]
    yield "`uvx`, the first time", Took(0.0, _until_traces(uvx, variables))
    yield "`uvx`, again", Took(0.0, _until_traces(uvx, variables))
    pipx = [UV, "tool", "run", "--from", "pipx", "pipx", "install", "--quiet"]
    install_s = _call([*pipx, "--python", place.python, wheel_there], variables)
    yield "`pipx install`", Took(install_s, _until_traces([there / "bin" / program], variables))


def _here() -> Iterator[Place]:
    system = platform.freedesktop_os_release()["PRETTY_NAME"].partition(" (")[0]
    for version in PYTHONS:
        found = subprocess.run(
            [UV, "python", "find", "--system", "--no-python-downloads", version],
            capture_output=True,
            text=True,
            check=False,
        )
        if found.returncode == 0:
            yield Place(f"{system}, Python {version}", found.stdout.strip())


def _debian(release: str, version: str, folder: Path) -> Place:
    """Make a Debian in a folder; that it was built is no part of the time."""
    root = folder / release
    subprocess.run(
        [
            *("mmdebstrap", "--quiet", "--variant=minbase"),
            # A mirror may have a day of the past.
            '--aptopt=Acquire::Check-Valid-Until "false"',
            f"--include={_IN_DEBIAN.format(version)}",
            *(release, root, mirror()),
        ],
        check=True,
    )
    for each in ("/etc/resolv.conf", "/etc/hosts", "/etc/ssl/certs/ca-certificates.crt"):
        shutil.copy(each, root / each.removeprefix("/"))
    mounts = f"mount -t proc proc {root}/proc && mount --rbind /dev {root}/dev"
    inside = f'{mounts} && exec /usr/sbin/chroot {root} "$@"'
    command = ("unshare", "--mount", "--propagation", "private", "sh", "-c", inside, "sh")
    return Place(f"Debian {release}, Python {version}", f"/usr/bin/python{version}", command, root)


def main() -> None:
    """Measure and print."""
    arguments = argparse.ArgumentParser(prog="benchmarks.reach", description=__doc__)
    arguments.add_argument("--debian", nargs="*", default=[], metavar="RELEASE:PYTHON")
    arguments.add_argument("--only-debian", action="store_true")
    asked = arguments.parse_args()
    with tempfile.TemporaryDirectory(prefix="reach-") as made:
        folder = Path(made)
        wheel = build(ROOT, folder / "wheel", "--wheel")
        source = build(ROOT, folder / "sdist", "--sdist")
        places = [] if asked.only_debian else [*_here()]
        for each in asked.debian:
            release, _, version = each.partition(":")
            places.append(_debian(release, version, folder))
        print(f"| {platform.machine()} | Way | Install, s | To the first traces, s | In all, s |")
        print("|---|---|---:|---:|---:|")
        for number, place in enumerate(places):
            home = (place.root if place.inside else folder) / f"home-{number}"
            home.mkdir()
            for way, took in _ways(place, wheel, home):
                figures = (took.install_s, took.traces_s, sum(took))
                cells = " | ".join(f"{each:.1f}" for each in figures)
                print(f"| {place.system} | {way} | {cells} |", flush=True)
        print()
        for built in (wheel, source, *(file for each in _BUILT for file in ROOT.glob(each))):
            print(f"{built.name}: {built.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    main()
