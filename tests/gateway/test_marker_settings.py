"""The settings of markers: names of buttons."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from biosensor_common.errors import ConfigError
from biosensor_gateway.settings.file import load_settings


def buttons(path: Path, text: str) -> tuple[str, ...]:
    path.write_text(text, encoding="utf-8")
    return load_settings(path, {}).markers.buttons


def test_buttons_are_a_setting(tmp_path: Path) -> None:
    path = tmp_path / "settings.toml"
    assert buttons(path, "") == ("baseline", "stimulus on", "stimulus off")
    assert buttons(path, '[markers]\nbuttons = ["Ruhe", "Übung 1"]') == ("Ruhe", "Übung 1")
    assert buttons(path, "[markers]\nbuttons = []") == ()
    twenty = [f"b{number}" for number in range(20)]
    assert buttons(path, f"[markers]\nbuttons = {json.dumps(twenty)}") == tuple(twenty)


@pytest.mark.parametrize(
    "value",
    [
        '"baseline"',
        "[1]",
        '[""]',
        '[" baseline"]',
        '["two\\nlines"]',
        json.dumps(["b" * 33]),
        json.dumps([f"b{number}" for number in range(21)]),
    ],
)
def test_buttons_that_are_none_are_refused(tmp_path: Path, value: str) -> None:
    with pytest.raises(ConfigError, match=r"line 2: 'markers\.buttons'"):
        buttons(tmp_path / "settings.toml", f"[markers]\nbuttons = {value}")


def test_a_button_that_is_there_twice_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="should have no name twice, but has 'b'"):
        buttons(tmp_path / "settings.toml", '[markers]\nbuttons = ["a", "b", "b"]')
