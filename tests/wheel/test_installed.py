"""What was built, and what becomes of it where it is installed: each Python, each way, upgrades."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest

from tests.wheel.conftest import ROOT, UV, Installed, build, users, uv

pytestmark = [pytest.mark.nightly, pytest.mark.timeout(600)]

PEERS = ROOT / ".venv-peers/bin/python"
PYTHONS = ("3.11", "3.12", "3.13", "3.14")


@pytest.mark.parametrize("repository", ["", "https://example.org/lab/gateway"])
def test_a_package_index_would_take_it(tmp_path: Path, repository: str) -> None:
    built = [build(ROOT, tmp_path / kind, f"--{kind}", repository) for kind in ("wheel", "sdist")]
    done = subprocess.run(
        [PEERS, "-m", "twine", "check", "--strict", *built],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.count("PASSED") == 2


def test_the_source_has_no_tests_and_makes_the_same_wheel(tmp_path: Path, wheel: Path) -> None:
    source = build(ROOT, tmp_path / "sdist", "--sdist")
    with tarfile.open(source) as archive:
        names = [each.partition("/")[2] for each in archive.getnames()]
        archive.extractall(tmp_path, filter="data")
    assert [each for each in names if each.startswith(("tests", "docs", "installer"))] == []
    assert source.stat().st_size < 3_000_000
    (unpacked,) = tmp_path.glob("biosensor_gateway-*")
    assert _content(build(unpacked, tmp_path / "wheel", "--wheel")) == _content(wheel)


def _content(wheel: Path) -> dict[str, int]:
    with zipfile.ZipFile(wheel) as archive:
        return {each.filename: each.CRC for each in archive.infolist()}


@pytest.mark.parametrize("python", PYTHONS)
def test_it_streams_records_exports_and_checks_itself(
    tmp_path: Path, wheel: Path, python: str
) -> None:
    installed = Installed(tmp_path, wheel, _require(python))
    assert re.fullmatch(r"biosensor-gateway \d\S+\n", installed.run("--version"))
    said = installed.run("try", "--no-open", "--seconds", "20")
    assert re.search(r"^(green|amber): ", said, re.MULTILINE), said
    # What it finds is this computer's; that it looked is the wheel's.
    assert "liblsl" in installed.run("doctor", codes=(0, 1))
    agent = installed.start("run", "--simulate", "polar_h10,shimmer3_gsr")
    installed.run("wait-ready")
    file = tmp_path / "study.xdf"
    installed.run("record", "start", "--here", "--file", str(file))
    installed.run("record", "stop")
    installed.run("stop")
    agent.communicate(timeout=60)
    assert agent.returncode == 0
    assert "error:" not in installed.run("xdf", "check", str(file))
    installed.run("xdf", "export", str(file), "--to", "csv", "--to", "edf", "--to", "mcap")
    assert (tmp_path / "study_csv" / "polar_h10-virtual-ecg.csv").is_file()


def _require(python: str) -> str:
    found = subprocess.run(
        [UV, "python", "find", "--system", "--no-python-downloads", python],
        capture_output=True,
        text=True,
        check=False,
    )
    if found.returncode:
        pytest.skip(f"NOT RUN: there is no Python {python} on this computer")
    return found.stdout.strip()


def test_uvx_needs_no_installation(tmp_path: Path, wheel: Path) -> None:
    home = tmp_path / "home"
    home.mkdir()
    said = uv(
        *("tool", "run", "--from", wheel, "biosensor-gateway"),
        *("try", "--no-open", "--seconds", "20"),
        folder=tmp_path,
        variables={**users(home), "UV_CACHE_DIR": uv("cache", "dir").strip()},
    )
    assert re.search(r"^(green|amber): ", said, re.MULTILINE), said


def test_pipx_installs_it(tmp_path: Path, wheel: Path) -> None:
    program = ("tool", "run", "--from", "pipx", "pipx")
    variables = {"PIPX_HOME": str(tmp_path / "pipx"), "PIPX_BIN_DIR": str(tmp_path / "bin")}
    uv(*program, "install", "--python", sys.executable, wheel, variables=variables)
    done = subprocess.run(
        [tmp_path / "bin" / "biosensor-gateway", "--version"], capture_output=True, check=True
    )
    assert done.stdout.startswith(b"biosensor-gateway ")


def test_an_upgrade_keeps_settings_recordings_and_what_was_paused(
    tmp_path: Path, wheel: Path
) -> None:
    later = build(_source_of("99.0.0", tmp_path / "source"), tmp_path / "later", "--wheel")
    installed = Installed(tmp_path / "pc", wheel)
    settings = installed.home / ".config" / "biosensor-gateway" / "settings.toml"
    settings.parent.mkdir(parents=True)
    settings.write_text('[log]\nlevel = "info"\n# Über uns\n', encoding="utf-8")
    agent = installed.start("run", "--simulate", "polar_h10")
    installed.run("wait-ready")
    file = installed.folder / "study.xdf"
    installed.run("record", "start", "--here", "--file", str(file))
    installed.run("record", "stop")
    installed.run("pause", "polar_h10")
    installed.run("stop")
    agent.communicate(timeout=60)
    before = _files(installed.home), file.read_bytes()

    installed.upgrade(later)
    assert installed.run("--version") == "biosensor-gateway 99.0.0\n"
    assert (_files(installed.home), file.read_bytes()) == before
    agent = installed.start("run", "--simulate", "polar_h10")
    installed.run("wait-ready", "--timeout", "20", codes=(1,))
    assert "paused" in installed.run("status")
    installed.run("stop")
    agent.communicate(timeout=60)
    assert settings.read_text(encoding="utf-8").endswith("# Über uns\n")
    assert "error:" not in installed.run("xdf", "check", str(file))


def _source_of(version: str, folder: Path) -> Path:
    """Copy what a wheel is built of, and give it another version."""
    names = ["hatch_build.py", "pyproject.toml", "README.md", "CHANGELOG.md", "LICENSE"]
    for name in ("common", "gateway_win", "ros_side/lsl_to_ros", *names):
        origin, target = ROOT / name, folder / name
        target.parent.mkdir(parents=True, exist_ok=True)
        if origin.is_dir():
            shutil.copytree(origin, target, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            shutil.copyfile(origin, target)
    project = folder / "pyproject.toml"
    text = project.read_text(encoding="utf-8")
    project.write_text(re.sub(r'(?m)^version = ".*"$', f'version = "{version}"', text, count=1))
    return folder


def _files(folder: Path) -> dict[str, bytes]:
    files = [each for each in folder.rglob("*") if each.is_file()]
    return {str(each.relative_to(folder)): each.read_bytes() for each in files}
