"""The settings file is edited: where keys stand, devices that change, the user's editor."""

from __future__ import annotations

import os
import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, cast

import pytest
from hypothesis import given
from hypothesis import strategies as st

from biosensor_common.errors import ConfigError, ConfigReason
from biosensor_gateway.cli import config as settings_command
from biosensor_gateway.devices.registry import settings_models
from biosensor_gateway.settings import file as settings_file
from biosensor_gateway.settings.editor import (
    change_device,
    remove_device,
    set_marker_buttons,
    set_participant,
)
from biosensor_gateway.settings.problems import KeyPath, key_lines

if TYPE_CHECKING:
    from tests.gateway.conftest import Outcome

# Devices of the settings file are changed and removed; everything else in it stays.

FILE = """\
# Our lab.
[lsl]
session_id = "lab" # the same in LabRecorder

# The strap with the red tape.
[[device]]
sensor = "polar_h10"
unit = "A1" # on its back
participant = "p01"

# The belt.
[[device]]
sensor = "zephyr"
unit = "B2"
port = "COM7"
"""
MODELS = settings_models()


@pytest.fixture
def path(tmp_path: Path) -> Path:
    path = tmp_path / "settings.toml"
    path.write_text(FILE)
    path.chmod(0o600)
    return path


def test_a_change_touches_its_line_alone(path: Path) -> None:
    change_device(path, MODELS, "polar_h10", "A1", {"participant": "p02"})
    assert path.read_text() == FILE.replace('"p01"', '"p02"')
    assert path.stat().st_mode & 0o777 == 0o600
    assert list(path.parent.iterdir()) == [path]


def test_keys_come_and_go(path: Path) -> None:
    change_device(path, MODELS, "polar_h10", "A1", {"participant": None, "label": "left"})
    text = path.read_text()
    assert "participant" not in text
    assert text.index('unit = "A1" # on its back') < text.index('label = "left"')
    assert text.index('label = "left"') < text.index('sensor = "zephyr"')


def test_one_person_wears_all_that_is_enabled(path: Path) -> None:
    path.write_text(f'{FILE}\n[[device]]\nsensor = "polar_h10"\nunit = "C3"\nenabled = false\n')
    set_participant(path, MODELS, "P02")
    text = path.read_text()
    assert text.count('participant = "P02"') == 2
    assert text.index('participant = "P02"') < text.index("# The belt.")
    assert "P02" not in text.partition("C3")[2]
    assert 'unit = "A1" # on its back' in text


def test_two_of_a_kind_are_not_made_one_persons(path: Path) -> None:
    path.write_text(f'{FILE}\n[[device]]\nsensor = "zephyr"\nunit = "C3"\nport = "COM8"\n')
    before = path.read_text()
    with pytest.raises(ConfigError, match="a second zephyr"):
        set_participant(path, MODELS, "P02")
    assert path.read_text() == before


def test_a_device_is_removed_with_what_belongs_to_it(path: Path) -> None:
    remove_device(path, MODELS, "polar_h10", "A1")
    text = path.read_text()
    assert "A1" not in text
    assert 'session_id = "lab" # the same in LabRecorder' in text
    assert 'port = "COM7"' in text
    remove_device(path, MODELS, "zephyr", "B2")
    assert "[[device]]" not in path.read_text()


def test_a_link_stays_a_link(path: Path, tmp_path: Path) -> None:
    link = tmp_path / "linked.toml"
    link.symlink_to(path)
    change_device(link, MODELS, "zephyr", "B2", {"enabled": False})
    assert link.is_symlink()
    assert "enabled = false" in path.read_text()


@pytest.mark.parametrize(
    ("unit", "fields", "reason"),
    [
        ("none", {"label": "x"}, ConfigReason.NOT_FOUND),
        ("B2", {"label": " x "}, ConfigReason.WRONG_VALUE),
        ("B2", {"unknown": "x"}, ConfigReason.UNKNOWN_KEY),
        ("B2", {"port": None}, ConfigReason.WRONG_VALUE),
    ],
)
def test_what_would_make_the_file_wrong_is_refused(
    path: Path, unit: str, fields: dict[str, str | None], reason: ConfigReason
) -> None:
    with pytest.raises(ConfigError) as caught:
        change_device(path, MODELS, "zephyr", unit, fields)
    assert caught.value.reason is reason
    assert str(path) in str(caught.value)
    assert path.read_text() == FILE


def test_a_folder_that_cannot_be_written_is_said(path: Path) -> None:
    blocked = path.with_name(f"{path.name}.{os.getpid()}")
    blocked.mkdir()
    with pytest.raises(ConfigError, match="cannot write"):
        remove_device(path, MODELS, "zephyr", "B2")
    assert path.read_text() == FILE


BUTTONS = ("baseline", "task", "rest, eyes closed")


@pytest.mark.parametrize(
    "before",
    [
        FILE,
        "",
        '[markers]\nbuttons = ["old"] # as on the sheet\n\n[markers.web]\nport = 17871\n\n' + FILE,
        "[markers.web]\nport = 17871\n\n" + FILE,
    ],
)
def test_buttons_of_markers_are_named_and_all_else_stays(path: Path, before: str) -> None:
    path.write_text(before)
    set_marker_buttons(path, MODELS, BUTTONS)
    loaded = settings_file.load_settings(path, MODELS)
    assert loaded.markers.buttons == BUTTONS
    assert loaded.markers.web.port == 17871
    assert len(loaded.devices) == before.count("[[device]]")
    for line in before.splitlines():
        assert line.partition('["old"]')[0] in path.read_text()


def test_the_first_buttons_make_a_file(tmp_path: Path) -> None:
    path = tmp_path / "settings.toml"
    set_marker_buttons(path, MODELS, BUTTONS)
    assert settings_file.load_settings(path, MODELS).markers.buttons == BUTTONS


@pytest.mark.parametrize("wrong", [["a", "a"], [""], ["x" * 300], [f"b{n}" for n in range(100)]])
def test_buttons_that_cannot_be_are_refused(path: Path, wrong: list[str]) -> None:
    with pytest.raises(ConfigError):
        set_marker_buttons(path, MODELS, wrong)
    assert path.read_text() == FILE


# ``config edit``: the settings file in the user's editor.
Run = Callable[..., "Outcome"]


@pytest.fixture
def programs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The only folder in which programs are found; nothing says which editor to use."""
    folder = tmp_path / "programs"
    folder.mkdir()
    monkeypatch.setenv("PATH", str(folder))
    for variable in ("VISUAL", "EDITOR"):
        monkeypatch.delenv(variable, raising=False)
    return folder


def install(folder: Path, name: str, code: int = 0) -> Path:
    """Install a program that writes down its arguments; return where it writes them."""
    program, notes = folder / name, folder / f"{name}.txt"
    program.write_text(
        f'#!/bin/sh\nfor each; do printf "%s\\n" "$each" >> "{notes}"; done\nexit {code}\n'
    )
    program.chmod(0o755)
    return notes


def lines(notes: Path) -> list[str]:
    return notes.read_text().splitlines()


@pytest.mark.nightly
def test_the_first_time_the_settings_are_written(run: Run, settings: Path, programs: Path) -> None:
    notes = install(programs, "xdg-open")
    assert run("config", "edit") == (0, f"wrote {settings}\n", "")
    assert lines(notes) == [str(settings)]
    assert run("config", "check").code == 0
    settings.write_text("# mine\n")
    assert run("config", "edit") == (0, "", "")
    assert settings.read_text() == "# mine\n"


@pytest.mark.nightly
def test_other_settings_can_be_named(
    run: Run, settings: Path, programs: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(programs.parent)
    notes = install(programs, "xdg-open")
    assert run("config", "edit", "--settings", "other settings.toml").code == 0
    assert lines(notes) == [str(programs.parent / "other settings.toml")]
    assert not settings.exists()


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("variables", "arguments"),
    [
        ({"EDITOR": "mine"}, []),
        ({"VISUAL": "mine --wait 'a b'", "EDITOR": "other"}, ["--wait", "a b"]),
        ({"VISUAL": "", "EDITOR": "mine -n"}, ["-n"]),
    ],
)
def test_the_editor_of_the_environment_goes_first(
    run: Run,
    settings: Path,
    programs: Path,
    monkeypatch: pytest.MonkeyPatch,
    variables: dict[str, str],
    arguments: list[str],
) -> None:
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    notes, other = install(programs, "mine"), install(programs, "xdg-open")
    assert run("config", "edit").code == 0
    assert lines(notes) == [*arguments, str(settings)]
    assert not other.exists()


def test_without_an_editor_the_path_is_said(run: Run, settings: Path, programs: Path) -> None:
    del programs
    outcome = run("config", "edit")
    assert outcome.code == 2
    assert outcome.err.count("\n") == 1
    assert str(settings) in outcome.err
    assert settings.exists()


@pytest.mark.nightly
@pytest.mark.parametrize("editor_", ["missing", "failing", "'open"])
def test_an_editor_that_fails_is_named_with_the_path(
    run: Run, settings: Path, programs: Path, monkeypatch: pytest.MonkeyPatch, editor_: str
) -> None:
    install(programs, "failing", code=3)
    monkeypatch.setenv("EDITOR", editor_)
    outcome = run("config", "edit")
    assert outcome.code == 2
    assert outcome.err.count("\n") == 1
    assert editor_ in outcome.err
    assert str(settings) in outcome.err


def test_a_file_that_cannot_be_written_is_one_sentence(run: Run, programs: Path) -> None:
    notes = install(programs, "xdg-open")
    outcome = run("config", "edit", "--settings", str(notes.parent / "xdg-open" / "s.toml"))
    assert outcome.code == 2
    assert outcome.err.count("\n") == 1
    assert not notes.exists()


@pytest.mark.nightly
def test_macos_opens_a_text_editor(
    run: Run, settings: Path, programs: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    notes = install(programs, "open")
    monkeypatch.setattr(settings_command.sys, "platform", "darwin")
    assert run("config", "edit").code == 0
    assert lines(notes) == ["-t", str(settings)]


# The locator of keys, checked against what the standard library's parser reads.
TRICKY = '''\
# [lsl] session_id = "no"
"text" = """
[fake]
fake_key = 1 # no comment
""\\"still inside = 2
closed by five quotes"""""
literal = \'\'\'
[[device]]
\'\'\'
hash = "# not a comment = 1"
date = 1979-05-27 07:32:32
a.b.c = 1.5

[lsl] # key = 3
peers = [ # [x]
    "one", # "two",
    "three = 3",

    [{ deep = "]", "qu.oted" = 'x#y' }],
]
"esc\\u0061ped" = true
[[device]]
unit = "A"
  [device.extra]
  gain = 1
[[device]]
unit = "B"
[device.extra]
gain = 2
[[device.part]]
name = "p"
[[device.part]]
name = "q"
[ "dotted.table" . 'sub' ]
x=1'''


def flatten(value: object, path: KeyPath = ()) -> Iterator[tuple[KeyPath, object]]:
    if path:
        yield path, value
    if isinstance(value, dict):
        for key, inner in cast("dict[str, object]", value).items():
            yield from flatten(inner, (*path, key))
    elif isinstance(value, list):
        for index, inner in enumerate(cast("list[object]", value)):
            yield from flatten(inner, (*path, index))


def test_every_key_of_a_tricky_file_is_found() -> None:
    lines = key_lines(TRICKY)
    assert set(lines) == {path for path, _ in flatten(tomllib.loads(TRICKY))}


def test_lines_in_a_tricky_file() -> None:
    lines = key_lines(TRICKY)
    expected: dict[KeyPath, str] = {
        ("text",): '"text"',
        ("literal",): "literal",
        ("hash",): "hash",
        ("a", "b", "c"): "a.b.c",
        ("lsl",): "[lsl]",
        ("lsl", "peers", 1): '"three',
        ("lsl", "peers", 2, 0, "deep"): "[{ deep",
        ("lsl", "peers", 2, 0, "qu.oted"): "[{ deep",
        ("lsl", "escaped"): '"esc',
        ("device", 1, "unit"): 'unit = "B"',
        ("device", 0, "extra", "gain"): "gain = 1",
        ("device", 1, "extra", "gain"): "gain = 2",
        ("device", 1, "part", 1, "name"): 'name = "q"',
        ("dotted.table", "sub", "x"): "x=1",
    }
    source = TRICKY.split("\n")
    found = {path: source[lines[path] - 1].strip() for path in expected}
    assert all(found[path].startswith(start) for path, start in expected.items()), found


def test_windows_line_ends_count_once() -> None:
    assert key_lines('a = """\r\n"""\r\nb = 1\r\n')["b",] == 3


NAMES = st.text(st.sampled_from("abcxyz_-0"), min_size=1, max_size=3)
KEYS = st.one_of(
    NAMES,
    NAMES.map(lambda name: f'"{name}"'),
    NAMES.map(lambda name: f"'{name}.[{name}] # ='"),
)
NOISE = st.sampled_from(["", " ", "# [x] = {", "\t#]"])
TEXTS = st.sampled_from(
    ['"a = [#"', "'b\" = ]'", '"""\n[t]\nk = 1\n"" """""', "'''\nk = 1 '\n'''", '"\\""', '""', "''"]
)
SCALARS = st.one_of(st.just("<n>"), TEXTS, st.sampled_from(["true", "-1.5e3", "07:32:00"]))


def containers(values: st.SearchStrategy[str]) -> st.SearchStrategy[str]:
    separators = st.sampled_from([", ", ",\n  ", ", # ] }\n"])
    arrays = st.tuples(separators, st.lists(values, max_size=3)).map(
        lambda drawn: f"[\n{drawn[0].join(drawn[1])}\n]"
    )
    tables = st.lists(st.tuples(KEYS, values), max_size=3, unique_by=lambda pair: pair[0]).map(
        lambda pairs: "{ " + ", ".join(f"{key} = {value}" for key, value in pairs) + " }"
    )
    return st.one_of(arrays, tables)


VALUES = st.recursive(SCALARS, containers, max_leaves=5)
ASSIGNMENTS = st.tuples(st.lists(KEYS, min_size=1, max_size=2), VALUES, NOISE).map(
    lambda drawn: f"{' . '.join(drawn[0])} = {drawn[1]} {drawn[2]}"
)
HEADERS = st.tuples(st.lists(KEYS, min_size=1, max_size=3), st.booleans(), NOISE).map(
    lambda drawn: (
        f"{'[[' if drawn[1] else '['}{'.'.join(drawn[0])}{']]' if drawn[1] else ']'} {drawn[2]}"
    )
)
STATEMENTS = st.lists(st.one_of(ASSIGNMENTS, HEADERS, NOISE), max_size=12)


def valid_document(statements: list[str]) -> str:
    """Join the statements that fit to those before, each number made unique."""
    text = ""
    number = 1000
    for statement in statements:
        addition = statement
        while "<n>" in addition:
            addition = addition.replace("<n>", str(number), 1)
            number += 1
        try:
            tomllib.loads(f"{text}{addition}\n")
        except tomllib.TOMLDecodeError:
            continue
        text = f"{text}{addition}\n"
    return text


@given(STATEMENTS.map(valid_document))
def test_keys_are_found_where_they_stand(text: str) -> None:
    lines = key_lines(text)
    leaves = dict(flatten(tomllib.loads(text)))
    assert set(lines) == set(leaves)
    source = text.split("\n")
    for path, value in leaves.items():
        line = source[lines[path] - 1]
        keys = [part for part in path if isinstance(part, str)]
        if isinstance(path[-1], str):
            assert keys[-1] in line
        if isinstance(value, int) and value >= 1000:
            assert str(value) in line
