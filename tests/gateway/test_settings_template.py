"""The file that a new user starts from."""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Literal

import pytest
from pydantic import BaseModel, Field

from biosensor_common.errors import ConfigError, ConfigReason, SpecError
from biosensor_gateway.settings.file import load_settings
from biosensor_gateway.settings.models import (
    DeviceSettings,
    EventSettings,
    GatewaySettings,
    LslSettings,
    MarkerSettings,
    PowerSettings,
    WebMarkerSettings,
)
from biosensor_gateway.settings.template import template, write_template


class StrapSettings(DeviceSettings):
    """A device without settings of its own."""


class BoxSettings(DeviceSettings):
    """A device with settings of every sort."""

    port: str = Field(description="Serial port.", examples=["COM3"])
    gain: Literal["low", "high"] = Field(default="low", description="Amplifier.")
    channels: tuple[int, ...] = Field(default=(1, 2), strict=False, description="Which ones.")
    rate: float | None = Field(default=None, description="Sampling rate in Hz.")


MODELS: dict[str, type[DeviceSettings]] = {"strap": StrapSettings, "box": BoxSettings}


@pytest.fixture(autouse=True)
def clean_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in list(os.environ):
        if name.upper().startswith("BIOSENSOR_GATEWAY_"):
            monkeypatch.delenv(name)


def test_the_template_loads_as_it_stands(tmp_path: Path) -> None:
    path = tmp_path / "settings.toml"
    path.write_text(template(MODELS), encoding="utf-8")
    assert load_settings(path, MODELS) == GatewaySettings()


def test_the_template_loads_with_every_example_switched_on(tmp_path: Path) -> None:
    text = re.sub(r"^#(?! )", "", template(MODELS), flags=re.MULTILINE)
    path = tmp_path / "settings.toml"
    path.write_text(text, encoding="utf-8")
    settings = load_settings(path, MODELS)
    assert settings.lsl == LslSettings()
    assert settings.power == PowerSettings()
    assert settings.events == EventSettings()
    assert settings.markers == MarkerSettings()
    assert [type(device) for device in settings.devices] == [StrapSettings, BoxSettings]
    assert settings.devices[1] == BoxSettings(sensor="box", unit="0123456789", port="COM3")


def test_the_template_names_and_describes_every_field() -> None:
    text = template(MODELS)
    joined = re.sub(r"\n# ", " ", text)
    sections = (LslSettings, PowerSettings, EventSettings, MarkerSettings, WebMarkerSettings)
    for model in (*sections, StrapSettings, BoxSettings):
        for key, field in model.model_fields.items():
            is_table = isinstance(field.default, BaseModel)
            assert key == "rate" or (f".{key}]\n" if is_table else f"\n#{key} = ") in text
            assert key == "sensor" or is_table or str(field.description) in joined


def test_a_field_that_cannot_be_shown_is_a_fault_of_its_driver() -> None:
    class Bare(DeviceSettings):
        port: str

    with pytest.raises(SpecError, match="'port'"):
        template({"bare": Bare})


def test_the_template_is_written_once(tmp_path: Path) -> None:
    path = tmp_path / "new" / "folder" / "settings.toml"
    write_template(path, MODELS)
    assert load_settings(path, MODELS) == GatewaySettings()
    path.write_text("mine")
    with pytest.raises(ConfigError, match="not overwritten") as caught:
        write_template(path, MODELS)
    assert caught.value.reason is ConfigReason.EXISTS
    assert path.read_text() == "mine"


def test_a_file_in_the_place_of_a_folder_is_said(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(ConfigError, match="cannot make the folder") as caught:
        write_template(tmp_path / "file" / "settings.toml", MODELS)
    assert caught.value.reason is ConfigReason.UNREADABLE
