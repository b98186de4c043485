"""Environment variables over the settings file."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import pytest

from biosensor_common.errors import ConfigError, ConfigReason
from biosensor_gateway.settings.file import load_settings
from biosensor_gateway.settings.models import DeviceSettings, GatewaySettings, LslSettings
from biosensor_gateway.settings.places import settings_path, state_folder

MODELS = {"strap": DeviceSettings}
DEVICE = '[[device]]\nsensor = "strap"\nunit = "A"\n'


@pytest.fixture(autouse=True)
def clean_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in list(os.environ):
        if name.upper().startswith("BIOSENSOR_GATEWAY_"):
            monkeypatch.delenv(name)


Loader = Callable[[str], GatewaySettings]
Refusal = Callable[[str], ConfigError]


@pytest.fixture
def load(tmp_path: Path) -> Loader:
    def load_text(text: str) -> GatewaySettings:
        path = tmp_path / "settings.toml"
        path.write_bytes(text.encode())
        return load_settings(path, MODELS)

    return load_text


@pytest.fixture
def refuse(load: Loader) -> Refusal:
    def error_of(text: str) -> ConfigError:
        with pytest.raises(ConfigError) as caught:
            load(text)
        return caught.value

    return error_of


def test_the_environment_overrides_the_file(load: Loader, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("BIOSENSOR_GATEWAY_LSL__SESSION_ID", "from-env")
    monkeypatch.setenv("BIOSENSOR_GATEWAY_LSL__PORT_RANGE", "64")
    monkeypatch.setenv("BIOSENSOR_GATEWAY_LSL__KNOWN_PEERS", '["a", "b"]')
    settings = load("[lsl]\nsession_id = 'file'\nport_range = 32\n[log]\nlevel = 'error'")
    assert settings.lsl == LslSettings(session_id="from-env", known_peers=("a", "b"), port_range=64)
    assert settings.log.level == "error"


@pytest.mark.parametrize(
    ("variable", "value", "reason", "said"),
    [
        ("LSL__PORT_RANGE", "many", ConfigReason.WRONG_VALUE, "should be a whole number"),
        ("LSL__KNOWN_PEERS", "a,b", ConfigReason.WRONG_VALUE, "should be a list in JSON"),
        ("LSL__KNOWN_PEERS", '["a", ""]', ConfigReason.WRONG_VALUE, "should be a host name"),
        ("LSL", "x", ConfigReason.WRONG_VALUE, "'lsl' should be a table"),
        ("LSL", '{"sesion_id": "x"}', ConfigReason.UNKNOWN_KEY, "did you mean 'session_id'?"),
        ("LSL__SESION_ID", "x", ConfigReason.UNKNOWN_KEY, "LSL__SESSION_ID'?"),
        ("LSL_SESSION_ID", "x", ConfigReason.UNKNOWN_KEY, "LSL__SESSION_ID'?"),
        ("LOGS__LEVEL", "x", ConfigReason.UNKNOWN_KEY, "LOG__LEVEL'?"),
        ("DEVICE__0__UNIT", "x", ConfigReason.UNKNOWN_KEY, "it sets nothing"),
        ("LSL__PORT_RANGE__X", "1", ConfigReason.UNKNOWN_KEY, "it sets nothing"),
    ],
)
def test_a_bad_override_is_named_by_its_variable(
    refuse: Refusal,
    monkeypatch: pytest.MonkeyPatch,
    *,
    variable: str,
    value: str,
    reason: ConfigReason,
    said: str,
) -> None:
    monkeypatch.setenv(f"BIOSENSOR_GATEWAY_{variable}", value)
    error = refuse("")
    assert error.reason is reason
    assert str(error).startswith(f"environment variable BIOSENSOR_GATEWAY_{variable}: ")
    assert said in str(error)
    assert "\n" not in str(error)


def test_a_mistake_in_the_file_is_not_blamed_on_the_environment(
    refuse: Refusal, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("BIOSENSOR_GATEWAY_LSL", '{"session_id": "x"}')
    assert "line 2: 'lsl.port_range'" in str(refuse("[lsl]\nport_range = 0"))


@pytest.mark.parametrize("variable", ["DEVICE", "DEVICES", "BIOSENSOR_GATEWAY_DEVICE"])
def test_other_programs_variables_do_not_matter(
    load: Loader, monkeypatch: pytest.MonkeyPatch, variable: str
) -> None:
    monkeypatch.setenv(variable, "/dev/sda")
    assert load(DEVICE).devices[0].unit == "A"


def test_the_paths_follow_their_variables(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    assert settings_path().name == "settings.toml"
    assert "biosensor-gateway" in settings_path().parts
    assert "biosensor-gateway" in state_folder().parts
    monkeypatch.setenv("BIOSENSOR_GATEWAY_SETTINGS", str(tmp_path / "my.toml"))
    monkeypatch.setenv("BIOSENSOR_GATEWAY_STATE", str(tmp_path / "state"))
    assert settings_path() == tmp_path / "my.toml"
    assert state_folder() == tmp_path / "state"
    monkeypatch.setenv("BIOSENSOR_GATEWAY_STATE", "~/state")
    assert state_folder() == Path.home() / "state"
