"""What was built and its page, and what becomes of it where it is installed."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path
from typing import Any, cast

import pytest
from ruamel.yaml import YAML

from hatch_build import page
from tests.wheel.conftest import ROOT, UV, Installed, build, users, uv

PEERS = ROOT / ".venv-peers/bin/python"
PYTHONS = ("3.11", "3.12", "3.13", "3.14")
HERE = f"{sys.version_info.major}.{sys.version_info.minor}"


@pytest.mark.nightly
@pytest.mark.timeout(600)
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


@pytest.mark.nightly
@pytest.mark.timeout(600)
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


@pytest.mark.timeout(600)
@pytest.mark.parametrize(
    "python",
    [
        pytest.param(HERE, marks=pytest.mark.seam),
        *(pytest.param(each, marks=pytest.mark.nightly) for each in PYTHONS if each != HERE),
    ],
)
def test_it_streams_records_exports_and_checks_itself(
    tmp_path: Path, wheel: Path, python: str
) -> None:
    installed = Installed(tmp_path, wheel, _require(python))
    assert re.fullmatch(r"biosensor-gateway \d\S+\n", installed.run("--version"))
    said = installed.run("try", "--no-open", "--seconds", "20")
    assert "http://127.0.0.1:" in said
    assert "3 sensors stream." in said
    assert re.search(r"^(green|amber): ", said, re.MULTILINE), said
    kept = tmp_path / "biosensor-gateway-try"
    assert len([*kept.glob("*.xdf")]) == 1
    assert len([*kept.glob("*_csv/*.csv")]) > 10
    # Nothing else stays.
    assert [*installed.home.iterdir()] == []
    for node in ("lsl_to_ros", "ros_to_lsl"):
        assert installed.run(program=node, codes=(1,)).startswith(f"{node}: ROS 2 is missing, ")
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
    if python == HERE:
        return sys.executable
    found = subprocess.run(
        [UV, "python", "find", "--system", "--no-python-downloads", python],
        capture_output=True,
        text=True,
        check=False,
    )
    if found.returncode:
        pytest.skip(f"NOT RUN: there is no Python {python} on this computer")
    return found.stdout.strip()


@pytest.mark.nightly
@pytest.mark.timeout(600)
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


@pytest.mark.nightly
@pytest.mark.timeout(600)
def test_pipx_installs_it(tmp_path: Path, wheel: Path) -> None:
    program = ("tool", "run", "--from", "pipx", "pipx")
    variables = {"PIPX_HOME": str(tmp_path / "pipx"), "PIPX_BIN_DIR": str(tmp_path / "bin")}
    uv(*program, "install", "--python", sys.executable, wheel, variables=variables)
    done = subprocess.run(
        [tmp_path / "bin" / "biosensor-gateway", "--version"], capture_output=True, check=True
    )
    assert done.stdout.startswith(b"biosensor-gateway ")


@pytest.mark.nightly
@pytest.mark.timeout(600)
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


WORKFLOW = ROOT / ".github" / "workflows" / "unit.yml"


def _installed() -> dict[str, Any]:
    loaded = YAML(typ="safe", pure=True).load(WORKFLOW)  # pyright: ignore[reportUnknownMemberType]
    return cast("dict[str, Any]", loaded)["jobs"]["installed"]


@pytest.mark.nightly
@pytest.mark.timeout(600)
def test_they_see_no_checkout_and_are_run_on_each_system() -> None:
    job = _installed()
    assert [each for each in job["steps"] if "checkout" in each.get("uses", "")] == []
    systems = {each.partition("-")[0] for each in job["strategy"]["matrix"]["system"]}
    assert systems == {"ubuntu", "windows", "macos"}


@pytest.mark.nightly
@pytest.mark.timeout(600)
def test_they_do_what_they_are_to_do(tmp_path: Path, wheel: Path) -> None:
    installed = Installed(tmp_path, wheel)
    (step,) = (each for each in _installed()["steps"] if "xdf export" in each.get("run", ""))
    variables = users(installed.home)
    programs = tmp_path / "env" / "bin"
    done = subprocess.run(
        ["bash", "--noprofile", "--norc", "-eo", "pipefail", "-c", step["run"]],
        cwd=tmp_path,
        env={**variables, "PATH": f"{programs}:{variables['PATH']}"},
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert {each.name for each in tmp_path.glob("study_*")} >= {"study_bids", "study_csv"}


README = (ROOT / "README.md").read_text(encoding="utf-8")
REPOSITORY = "https://example.org/lab/gateway"
TARGETS = re.compile(r"\]\(([^)\s]+)\)")


@pytest.mark.parametrize("repository", ["", REPOSITORY])
def test_no_link_needs_the_repository(repository: str) -> None:
    shown = page(README, repository, "1.2.3")
    targets = TARGETS.findall(shown)
    assert targets
    assert [each for each in targets if not each.startswith("https://")] == []


def test_links_lead_to_the_release_and_pictures_are_pictures() -> None:
    shown = page(README, REPOSITORY, "1.2.3")
    assert f"({REPOSITORY}/blob/v1.2.3/docs/try-it.md)" in shown
    assert f"({REPOSITORY}/blob/v1.2.3/README.md#limits)" in shown
    assert f"({REPOSITORY}/raw/v1.2.3/docs/pictures/page.png)" in shown
    assert f"({REPOSITORY}/raw/v1.2.3/docs/pictures/demo.svg?sanitize=true)" in shown
    assert f"git clone {REPOSITORY} biosensor-gateway" in shown
    for place in TARGETS.findall(shown):
        path = place.removeprefix(REPOSITORY).partition("v1.2.3/")[2]
        assert (ROOT / re.split(r"[#?]", path)[0]).exists(), place


def test_without_an_address_the_words_stay() -> None:
    text = "![A\npicture](a.png) and [two\nwords](docs/a.md#b), [LSL](https://example.org)\n"
    assert page(text, "", "1") == " and two\nwords, [LSL](https://example.org)\n"
