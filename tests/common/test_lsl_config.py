"""The configuration of LSL: whose file is read, and what is laid over it."""

from __future__ import annotations

import configparser
from pathlib import Path

import pytest

from biosensor_common.errors import ConfigError, ConfigReason
from biosensor_common.lsl.inlet import MOST_BUFFERED, buffer_length
from biosensor_common.lsl_config import (
    LslOverrides,
    config_places,
    effective_config,
    home_config_file,
    user_config_file,
)


def overlaid(text: str, overrides: LslOverrides, folder: Path) -> dict[str, dict[str, str]]:
    """Lay the overrides over a user's file; return the settings by section."""
    path = folder / "lsl_api.cfg"
    path.write_text(text)
    parser = configparser.RawConfigParser()
    parser.optionxform = str  # type: ignore[assignment,method-assign]
    parser.read_string(effective_config(path, overrides))
    return {section: dict(parser[section]) for section in parser.sections()}


def test_lsl_s_own_order_is_kept(tmp_path: Path) -> None:
    home, folder, named = tmp_path / "home", tmp_path / "folder", tmp_path / "named.cfg"
    environment = {"LSLAPICFG": str(named)}
    places = config_places(environment, home, folder)
    assert places[:3] == (named, folder / "lsl_api.cfg", home / "lsl_api" / "lsl_api.cfg")
    assert places[1:] == config_places({"LSLAPICFG": ""}, home, folder)
    for place in reversed(places[:3]):
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_text("")
        assert user_config_file(environment, home, folder) == place
    assert user_config_file({}, home, folder) == folder / "lsl_api.cfg"
    assert home_config_file(home) in places


def test_the_user_s_settings_stay_where_ours_are_silent(tmp_path: Path) -> None:
    own = "[lab]\nSessionID = mine\nKnownPeers = {10.0.0.1}\n[tuning]\nMaxCachedQueries = 7\n"
    assert overlaid(own, LslOverrides(), tmp_path) == {
        "lab": {"SessionID": "mine", "KnownPeers": "{10.0.0.1}"},
        "tuning": {"MaxCachedQueries": "7"},
        "ports": {"PortRange": "256"},
        "log": {"level": "-1"},
    }


def test_ours_go_before_the_user_s(tmp_path: Path) -> None:
    own = "[lab]\nSessionID = mine\nKnownPeers = {10.0.0.1}\n[ports]\nPortRange = 512\n"
    overrides = LslOverrides("ours", ("10.0.0.2", "10.0.0.3"), 64)
    found = overlaid(own, overrides, tmp_path)
    assert found["lab"] == {"SessionID": "ours", "KnownPeers": "{10.0.0.2, 10.0.0.3}"}
    assert found["ports"] == {"PortRange": "64"}


def test_how_long_a_search_pauses_is_left_to_the_user(tmp_path: Path) -> None:
    own = "[tuning]\nUnicastMinRTT = 2\n"
    found = overlaid(own, LslOverrides(search_pause_s=0.1), tmp_path)
    assert found["tuning"] == {"UnicastMinRTT": "2", "MulticastMinRTT": "0.1"}
    assert "tuning" not in overlaid("", LslOverrides(), tmp_path)


@pytest.mark.parametrize(
    ("own", "effective"), [("512", "512"), ("32", "256"), ("many", "256"), ("-1", "256")]
)
def test_without_a_setting_of_ours_a_larger_range_of_ports_stays(
    own: str, effective: str, tmp_path: Path
) -> None:
    found = overlaid(f"[ports]\nPortRange = {own}\n", LslOverrides(), tmp_path)
    assert found["ports"] == {"PortRange": effective}


def test_a_damaged_file_is_named(tmp_path: Path) -> None:
    path = tmp_path / "lsl_api.cfg"
    path.write_text("SessionID\n")
    with pytest.raises(ConfigError, match=str(path)) as raised:
        effective_config(path, LslOverrides())
    assert raised.value.reason is ConfigReason.MALFORMED
    path.write_bytes(b"[lab]\nSessionID = \xff\n")
    with pytest.raises(ConfigError, match=str(path)) as raised:
        effective_config(path, LslOverrides())
    assert raised.value.reason is ConfigReason.UNREADABLE


def test_a_place_that_may_not_be_looked_into_has_no_file(tmp_path: Path) -> None:
    own = tmp_path / "lsl_api.cfg"
    own.touch()
    # Not even root can ask for a name that long.
    hidden = {"LSLAPICFG": str(tmp_path / ("x" * 300))}
    assert user_config_file(hidden, tmp_path / ("x" * 300), tmp_path) == own


@pytest.mark.parametrize("rate", [0.0, 0.5, 1.0, 256.0, MOST_BUFFERED / 121])
def test_a_usual_stream_is_buffered_for_so_long(rate: float) -> None:
    assert buffer_length(rate, 120) == 120


@pytest.mark.parametrize("rate", [MOST_BUFFERED / 119, 1e5, 1e6, 1e9])
def test_no_rate_takes_more_memory_than_the_bound_or_a_second(rate: float) -> None:
    length = buffer_length(rate, 120)
    assert 1 <= length < 120
    assert length * rate <= max(MOST_BUFFERED, rate)
    assert buffer_length(rate, 10, 200_000) <= length
