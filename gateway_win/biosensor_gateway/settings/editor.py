"""Edits devices and marker buttons in the settings file; comments and order are preserved.

A change that would make the file invalid is refused, and the file is not changed.
"""

from __future__ import annotations

import contextlib
import os
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, cast

import tomlkit
from tomlkit.exceptions import TOMLKitError
from tomlkit.items import AoT

from biosensor_common.errors import ConfigError, ConfigReason, cannot_write
from biosensor_gateway.settings import file as settings_file
from biosensor_gateway.settings import template
from biosensor_gateway.settings.models import DeviceSettings

Models = Mapping[str, type[DeviceSettings]]
"""Settings model of each known sensor, by sensor name."""
Value = str | int | float | bool

_DEVICE, _MARKERS = "device", "markers"


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
        template.write_template(path, models)
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
        template.write_template(path, models)
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
        message = f"{path}: each device is a table of its own, under [[device]] in double brackets"
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
