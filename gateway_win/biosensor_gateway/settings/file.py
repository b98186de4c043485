"""Reads and validates the settings file, and reports all its problems at once."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, cast

from pydantic import ValidationError

from biosensor_common.errors import ConfigError, ConfigReason
from biosensor_gateway.settings.models import DeviceSettings, GatewaySettings
from biosensor_gateway.settings.problems import (
    Problem,
    from_validation,
    key_lines,
    report,
    unknown_key,
    unknown_variables,
    wrong_choice,
)

_WHERE = re.compile(r"(?P<what>.*) \(at (?P<where>.*)\)", re.DOTALL)
_DEVICE = "device"


def load_settings(path: Path, device_models: Mapping[str, type[DeviceSettings]]) -> GatewaySettings:
    """Read and validate the settings, with the environment's overrides.

    Parameters
    ----------
    device_models
        Settings model of each known sensor, by sensor name.

    Raises
    ------
    ConfigError
        ``NOT_FOUND``, ``UNREADABLE``, ``MALFORMED``, ``UNKNOWN_KEY`` or
        ``WRONG_VALUE``. The message has one line for each thing to correct,
        with its file and line or its environment variable; the reason is that
        of the first.
    """
    return settings_of(path, read_text(path), device_models)


def load_or_defaults(
    path: Path, device_models: Mapping[str, type[DeviceSettings]]
) -> GatewaySettings:
    """Read the settings, or the defaults if there is no file; see `load_settings`."""
    try:
        text = read_text(path)
    except ConfigError as error:
        if error.reason is not ConfigReason.NOT_FOUND:
            raise
        # The environment's overrides hold all the same, and can be wrong.
        text = ""
    return settings_of(path, text, device_models)


def settings_of(
    path: Path, text: str, device_models: Mapping[str, type[DeviceSettings]]
) -> GatewaySettings:
    """Validate the text of a settings file; see `load_settings`."""
    data = _parse(path, text)
    sections = {key: value for key, value in data.items() if key in _top_level_keys()}
    problems = [unknown_key((key,), GatewaySettings) for key in data if key not in sections]
    devices = _Devices(sections.pop(_DEVICE, []), device_models)
    problems += [*devices.problems, *unknown_variables(GatewaySettings)]
    settings = None
    try:
        settings = GatewaySettings(**sections, device=tuple(devices.valid.values()))
    except ValidationError as error:
        problems += from_validation(error, GatewaySettings)
    if settings is None or problems:
        raise report(path, key_lines(text), problems)
    return settings


def _top_level_keys() -> frozenset[str]:
    fields = GatewaySettings.model_fields
    return frozenset(field.alias or name for name, field in fields.items())


def read_text(path: Path) -> str:
    """Return the text of the settings file.

    Raises
    ------
    ConfigError
        ``NOT_FOUND`` or ``UNREADABLE``.
    """
    try:
        # utf-8-sig, because Windows editors write a byte order mark, which TOML does not allow.
        return path.read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        message = f"there is no settings file {path}; make one with `biosensor-gateway config init`"
        raise ConfigError(ConfigReason.NOT_FOUND, message) from None
    except UnicodeDecodeError as error:
        message = f"{path} is not UTF-8 text (byte {error.start}); save it again as UTF-8"
        raise ConfigError(ConfigReason.UNREADABLE, message) from error
    except OSError as error:
        hint = "it is a folder" if path.is_dir() else error.strerror or str(error)
        message = f"cannot read the settings file {path}: {hint}"
        raise ConfigError(ConfigReason.UNREADABLE, message) from error


def _parse(path: Path, text: str) -> dict[str, Any]:
    try:
        return tomllib.loads(text)
    except RecursionError:
        message = f"{path} is not valid TOML: its values are nested too deeply"
        raise ConfigError(ConfigReason.MALFORMED, message) from None
    except ValueError as error:  # also an integer of more digits than Python converts
        found = _WHERE.fullmatch(str(error))
        where, what = (f", {found['where']}", found["what"]) if found else ("", str(error))
        message = f"{path}{where}: not valid TOML: {what[:1].lower()}{what[1:]}"
        raise ConfigError(ConfigReason.MALFORMED, message) from error


class _Devices:
    """The entries of the file's device array, each validated by its sensor's model."""

    def __init__(self, entries: object, models: Mapping[str, type[DeviceSettings]]) -> None:
        self.valid: dict[int, DeviceSettings] = {}
        self.problems: list[Problem] = []
        self._models = models
        if not isinstance(entries, list):
            text = "each device needs its own table, under [[device]] in double brackets"
            self.problems.append(Problem(ConfigReason.WRONG_VALUE, (_DEVICE,), text))
            return
        for index, entry in enumerate(cast("list[object]", entries)):
            self._validate(index, entry)
        self.problems += self._duplicates()

    def _validate(self, index: int, entry: object) -> None:
        path = (_DEVICE, index)
        if not isinstance(entry, dict):
            text = "a device should be a table: [[device]] and one line for each key"
            self.problems.append(Problem(ConfigReason.WRONG_VALUE, path, text))
            return
        sensor = cast("dict[str, object]", entry).get("sensor")
        model = self._models.get(sensor) if isinstance(sensor, str) else None
        if model is None:
            where = (*path, "sensor") if "sensor" in entry else path
            problem = wrong_choice(where, "device.sensor", sensor, self._models)
            self.problems.append(problem)
            return
        try:
            self.valid[index] = model.model_validate(entry)
        except ValidationError as error:
            self.problems += from_validation(error, model, path)

    def _duplicates(self) -> Iterator[Problem]:
        seen: dict[tuple[str, ...], int] = {}
        for index, device in self.valid.items():
            for identity, key in _identities(device):
                first = seen.setdefault(identity, index)
                if first != index:
                    text = (
                        f"a second {device.sensor_name} with {key}; "
                        "change it, or set enabled = false in one of them"
                    )
                    other = (_DEVICE, first)
                    yield Problem(ConfigReason.WRONG_VALUE, (_DEVICE, index), text, other=other)


def _identities(device: DeviceSettings) -> Iterator[tuple[tuple[str, ...], str]]:
    """Yield the keys that must be unique among enabled devices, each with its text for people."""
    if not device.enabled:
        return
    name = device.sensor_name
    yield ("unit", name, device.unit), f"unit {device.unit!r}"
    if device.participant or device.label:
        names = f"participant {device.participant!r} and label {device.label!r}"
        yield ("person", name, device.participant, device.label), names
