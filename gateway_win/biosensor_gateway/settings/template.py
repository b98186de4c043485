"""Writes a first settings file: every key with its description, commented out.

Descriptions begin with ``# `` and settings with ``#``, so that removing one
character activates a setting.
"""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import cast

import tomlkit
from pydantic import BaseModel
from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined

from biosensor_common.errors import ConfigError, ConfigReason, SpecError, SpecReason, cannot_write
from biosensor_gateway.settings.models import (
    DeviceSettings,
    EventSettings,
    LogSettings,
    LslSettings,
    MarkerSettings,
    PowerSettings,
)

_WIDTH = 88
_INTRODUCTION = (
    "Settings of the Biosensor Gateway. A line that begins with # and no space shows a key with "
    "its default: remove the # to set it. "
    "Passwords and client secrets do not belong here."
)


def template(device_models: Mapping[str, type[DeviceSettings]]) -> str:
    """Return TOML with every setting, its description, and its default or an example.

    Parameters
    ----------
    device_models
        Settings model of each known sensor, by sensor name.

    Returns
    -------
    str
        TOML that loads unchanged and with any of its examples activated.

    Raises
    ------
    SpecError
        ``INVALID``, if a device's field has neither a default nor an example.
    """
    blocks = [
        _prose(_INTRODUCTION),
        _section("lsl", LslSettings),
        _section("log", LogSettings),
        _section("power", PowerSettings),
        _section("events", EventSettings),
        _section("markers", MarkerSettings),
        *(_example(sensor, model) for sensor, model in device_models.items()),
    ]
    return "\n".join("".join(f"{line}\n" for line in block) for block in blocks)


def write_template(path: Path, device_models: Mapping[str, type[DeviceSettings]]) -> None:
    """Write the template to a new file, with the folders above it.

    Raises
    ------
    ConfigError
        ``EXISTS`` if something is there already; ``UNREADABLE`` if the file
        cannot be written.
    """
    content = template(device_models)
    try:
        # On macOS it is the state folder, too, into which nobody else may look.
        path.parent.mkdir(0o700, parents=True, exist_ok=True)
    except OSError as error:
        message = f"cannot make the folder {path.parent}: {error.strerror or error}"
        raise ConfigError(ConfigReason.UNREADABLE, message) from error
    try:
        with path.open("x", encoding="utf-8") as file:
            file.write(content)
    except FileExistsError:
        message = f"{path} exists and is not overwritten; edit it, or move it away first"
        raise ConfigError(ConfigReason.EXISTS, message) from None
    except OSError as error:
        message = cannot_write(path, error)
        raise ConfigError(ConfigReason.UNREADABLE, message) from error


def _prose(text: str) -> list[str]:
    return textwrap.wrap(text, _WIDTH, initial_indent="# ", subsequent_indent="# ")


def _section(name: str, model: type[BaseModel]) -> Iterator[str]:
    yield f"[{name}]"
    inner: dict[str, type[BaseModel]] = {}
    for key, field in model.model_fields.items():
        if isinstance(field.default, BaseModel):
            inner[f"{name}.{key}"] = type(field.default)
        else:
            yield from _setting(name, key, field)
    # Inner tables come last, because TOML assigns all keys after a header to that table.
    for each, table in inner.items():
        yield ""
        yield from _section(each, table)


def _example(sensor: str, model: type[DeviceSettings]) -> Iterator[str]:
    yield "#[[device]]"
    for key, field in model.model_fields.items():
        if key == "sensor":
            yield f"#{_assignment(key, sensor)}"
        else:
            yield from _setting(sensor, key, field)


def _setting(owner: str, key: str, field: FieldInfo) -> Iterator[str]:
    yield from _prose(field.description or "")
    value = _shown_value(owner, key, field)
    if value is not None:
        yield f"#{_assignment(key, value)}"


def _shown_value(owner: str, key: str, field: FieldInfo) -> object:
    """Value to show; ``None`` for a key that is unset by default, which TOML cannot write."""
    default = cast("object", field.get_default(call_default_factory=True, validated_data={}))
    if default is not PydanticUndefined and default is not None:
        return default
    if field.examples:
        return cast("object", field.examples[0])
    if field.is_required():
        message = f"{owner}: the field {key!r} has neither a default nor an example"
        raise SpecError(SpecReason.INVALID, message)
    return None


def _assignment(key: str, value: object) -> str:
    written = tomlkit.item(cast("str", value)).as_string()
    return f"{key} = {written}"
