"""Which library pylsl is given where it brings none, and what is said where there is none."""

from __future__ import annotations

import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from biosensor_common import liblsl

BROUGHT = {
    "pylsl": "lib/liblsl.so",
    "biosensor_liblsl": "liblsl.so",
    "mne_lsl": "lsl/lib/liblsl.so.1.17.7",
}


@pytest.fixture
def packages(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder of packages in place of those that are installed, on Linux."""

    def find_spec(name: str) -> SimpleNamespace | None:
        folder = tmp_path / name
        return (
            SimpleNamespace(submodule_search_locations=[str(folder)]) if folder.is_dir() else None
        )

    monkeypatch.setattr(liblsl, "find_spec", find_spec)
    monkeypatch.setattr(sys, "platform", "linux")
    (tmp_path / "pylsl" / "lib").mkdir(parents=True)
    return tmp_path


def _bring(packages: Path, name: str) -> str:
    library = packages / name / BROUGHT[name]
    library.parent.mkdir(parents=True, exist_ok=True)
    library.touch()
    return str(library)


@pytest.mark.parametrize(
    ("there", "taken"),
    [
        ((), ""),
        (("mne_lsl",), "mne_lsl"),
        (("mne_lsl", "biosensor_liblsl"), "biosensor_liblsl"),
        (("pylsl", "biosensor_liblsl"), ""),
    ],
)
def test_another_library_is_taken_only_where_pylsl_brings_none(
    packages: Path, there: tuple[str, ...], taken: str
) -> None:
    places = {name: _bring(packages, name) for name in there}
    environment: dict[str, str] = {}
    liblsl.provide(environment)
    assert environment == ({liblsl.VARIABLE: places[taken]} if taken else {})


def test_what_a_person_has_named_stays(packages: Path) -> None:
    _bring(packages, "biosensor_liblsl")
    environment = {liblsl.VARIABLE: "/opt/liblsl.so"}
    liblsl.provide(environment)
    assert environment == {liblsl.VARIABLE: "/opt/liblsl.so"}


def test_nothing_is_named_on_other_systems(packages: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    _bring(packages, "biosensor_liblsl")
    monkeypatch.setattr(sys, "platform", "darwin")
    environment: dict[str, str] = {}
    liblsl.provide(environment)
    assert environment == {}


@pytest.mark.parametrize(
    ("machine", "libc", "said"),
    [
        ("x86_64", ("glibc", "2.36"), "--force-reinstall pylsl"),
        ("x86_64", ("glibc", "2.31"), "--no-deps mne-lsl"),
        ("aarch64", ("glibc", "2.36"), "--no-deps mne-lsl"),
        ("aarch64", ("", ""), "set PYLSL_LIB"),
        ("armv7l", ("glibc", "2.36"), "set PYLSL_LIB"),
    ],
)
def test_the_remedy_is_one_for_this_computer(
    monkeypatch: pytest.MonkeyPatch, machine: str, libc: tuple[str, str], said: str
) -> None:
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.setattr("platform.machine", lambda: machine)
    monkeypatch.setattr("platform.libc_ver", lambda: libc)
    assert said in liblsl.remedy()


def test_other_errors_are_not_taken_for_it() -> None:
    with pytest.raises(RuntimeError, match="LSL binary") as raised:
        raise RuntimeError("LSL binary library file was not found")
    assert liblsl.what_is_missing(raised.value) == ""


def test_a_program_that_lacks_it_ends_with_one_sentence(
    capsys: pytest.CaptureFixture[str],
) -> None:
    # As pylsl does when it is imported.
    code = compile("raise RuntimeError('not found. Please\\nread on')", "lib", "exec")
    with pytest.raises(SystemExit) as ended, liblsl.needed_by("lsl_to_ros"):
        exec(code, {"__name__": "pylsl.lib"})
    assert ended.value.code == 1
    said = capsys.readouterr().err
    assert said.startswith("lsl_to_ros: liblsl, the library of the Lab Streaming Layer, cannot be")
    assert said.count("\n") == 1
    with pytest.raises(RuntimeError), liblsl.needed_by("lsl_to_ros"):
        raise RuntimeError("another one")
