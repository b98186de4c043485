"""Writes a first settings file, and edits it; comments and order are preserved.

In a first file every key stands with its description, commented out: descriptions begin with
``# `` and settings with ``#``, so that removing one character activates a setting.

A change that would make the file invalid is refused, and the file is not changed.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, cast

import tomlkit
from pydantic import BaseModel
from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined
from tomlkit.exceptions import TOMLKitError
from tomlkit.items import AoT

from biosensor_common.errors import ConfigError, ConfigReason, SpecError, SpecReason, cannot_write
from biosensor_gateway.settings import file as settings_file
from biosensor_gateway.settings.models import (
    DeviceSettings,
    EventSettings,
    LogSettings,
    LslSettings,
    MarkerSettings,
    PowerSettings,
)
from biosensor_gateway.settings.places import SETTINGS_VARIABLE

Models = Mapping[str, type[DeviceSettings]]
"""Settings model of each known sensor, by sensor name."""
Value = str | int | float | bool

_DEVICE, _MARKERS = "device", "markers"
_WIDTH = 88
_INTRODUCTION = (
    "Settings of the Biosensor Gateway. A line that starts with # and no space shows a key with "
    "its default: remove the # to set it. Passwords and client secrets do not belong here."
)


def table_lines(sensor: str, fields: Mapping[str, Any]) -> str:
    """Return the TOML of a device's table."""
    table = tomlkit.table()
    table["sensor"] = sensor
    for key, value in fields.items():
        table[key] = value
    return f"[[{_DEVICE}]]\n{tomlkit.dumps(table).strip()}"


def add_device(path: Path, models: Models, sensor: str, fields: Mapping[str, Any]) -> None:
    """Add a device at the end of the settings file, which is created if there is none.

    Raises
    ------
    ConfigError
        If the file would be invalid, or cannot be written; it is not changed.
    """
    if not path.exists():
        write_template(path, models)
    before = _text(path)
    blank = "\n" if before.endswith("\n") else "\n\n"
    _write(path, models, f"{before}{blank}{table_lines(sensor, fields)}\n")


def change_device(
    path: Path, models: Models, sensor: str, unit: str, fields: Mapping[str, Value | None]
) -> None:
    """Set keys of a device's table; remove those that are None.

    Raises
    ------
    ConfigError
        ``NOT_FOUND`` if there is no such device; else as `add_device`.
    """
    document, tables = _parsed(path)
    table = tables[_index(path, tables, sensor, unit)]
    for key, value in fields.items():
        if value is None:
            if key in table:
                del table[key]
        else:
            table[key] = value
    _write(path, models, tomlkit.dumps(document))


def set_participant(path: Path, models: Models, participant: str) -> None:
    """Set the participant of all enabled devices in the settings file.

    Raises
    ------
    ConfigError
        As `add_device`; also if two devices would then have the same name.
    """
    document, tables = _parsed(path)
    for table in cast("list[dict[str, object]]", tables):
        if table.get("enabled", True):
            table["participant"] = participant
    _write(path, models, tomlkit.dumps(document))


def set_marker_buttons(path: Path, models: Models, names: Sequence[str]) -> None:
    """Set the names of the marker buttons; the file is created if there is none.

    Raises
    ------
    ConfigError
        As `add_device`.
    """
    if not path.exists():
        write_template(path, models)
    document, _ = _parsed(path)
    if _MARKERS not in document:
        document[_MARKERS] = tomlkit.table()
    table: Any = document[_MARKERS]
    table["buttons"] = [*names]
    _write(path, models, tomlkit.dumps(document))


def remove_device(path: Path, models: Models, sensor: str, unit: str) -> None:
    """Remove a device from the settings file.

    Raises
    ------
    ConfigError
        ``NOT_FOUND`` if there is no such device; else as `add_device`.
    """
    document, tables = _parsed(path)
    del tables[_index(path, tables, sensor, unit)]
    if not len(tables):
        del document[_DEVICE]
    _write(path, models, tomlkit.dumps(document))


def _text(path: Path) -> str:
    settings_file.read_text(path)
    # Read again as bytes, to preserve Windows' line ends.
    return path.read_bytes().decode("utf-8-sig")


def _parsed(path: Path) -> tuple[tomlkit.TOMLDocument, AoT]:
    try:
        document = tomlkit.parse(_text(path))
    except TOMLKitError as error:
        message = f"{path} is not valid TOML: {error}"
        raise ConfigError(ConfigReason.MALFORMED, message) from error
    tables: object = document[_DEVICE] if _DEVICE in document else AoT([])
    if not isinstance(tables, AoT):
        message = f"{path}: each device needs its own table, under [[device]] in double brackets"
        raise ConfigError(ConfigReason.WRONG_VALUE, message)
    return document, tables


def _index(path: Path, tables: AoT, sensor: str, unit: str) -> int:
    for index, table in enumerate(cast("list[dict[str, object]]", tables)):
        if (table.get("sensor"), table.get("unit")) == (sensor, unit):
            return index
    raise ConfigError(ConfigReason.NOT_FOUND, f"{path} has no device {sensor}/{unit}")


def _write(path: Path, models: Models, text: str) -> None:
    settings_file.settings_of(path, text, models)
    # Resolved, to replace the target of a link and not the link. The file is replaced as a whole.
    target = path.resolve()
    fresh = target.with_name(f"{target.name}.{os.getpid()}")
    try:
        fresh.write_bytes(text.encode())
        shutil.copymode(target, fresh)
        fresh.replace(target)
    except OSError as error:
        with contextlib.suppress(OSError):
            fresh.unlink(missing_ok=True)
        message = cannot_write(path, error)
        raise ConfigError(ConfigReason.UNREADABLE, message) from error


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
        message = (
            f"cannot make the folder {path.parent}: {error.strerror or error}; make it writable, "
            f"or name another file by the environment variable {SETTINGS_VARIABLE}"
        )
        raise ConfigError(ConfigReason.UNREADABLE, message) from error
    try:
        with path.open("x", encoding="utf-8") as file:
            file.write(content)
    except FileExistsError:
        message = f"{path} exists and is not overwritten; edit it, or move it first"
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
