"""Devices of the settings file are changed and removed; everything else in it stays."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from biosensor_common.errors import ConfigError, ConfigReason
from biosensor_gateway.devices.registry import settings_models
from biosensor_gateway.settings import file as settings_file
from biosensor_gateway.settings.editor import (
    change_device,
    remove_device,
    set_marker_buttons,
    set_participant,
)

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
