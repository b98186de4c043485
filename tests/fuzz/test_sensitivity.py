"""Every target notices when the code that it guards is broken, with its corpus alone."""

from __future__ import annotations

import importlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from math import inf
from operator import attrgetter
from pathlib import Path
from typing import Any

import pytest

from biosensor_common.header_channels import Channels
from biosensor_gateway.recording.xdf.container import Damage
from tests.fuzz.contract import CORPUS, NAMES, inputs, load, strictly

DEVICES = "biosensor_gateway.devices"
NO_CHANNELS = Channels((), (), (), says_roles=False)
Breaking = Callable[[Any], Any]
"""Makes a broken one of the sound one."""


def forgets_what_it_holds(feed: Any) -> Any:
    def broken(parser: Any, *arguments: Any) -> Any:
        parser._buffer.clear()
        return feed(parser, *arguments)

    return broken


def ends_too_late(find_damage: Any) -> Any:
    def broken(*where: Any) -> Damage:
        damage: Damage = find_damage(*where)
        return replace(damage, end=damage.end + 1)

    return broken


def loses_the_last(batches: Any) -> Any:
    def broken(*of: Any) -> Any:
        return iter(list(batches(*of))[:-1])

    return broken


def always(answer: object) -> Breaking:
    """Something that says the same whatever it is asked."""

    def broken(*arguments: object) -> object:
        return answer

    return lambda sound: broken


def instead(broken: Callable[..., object]) -> Breaking:
    return lambda sound: broken


def any_byte(data: bytes) -> int | None:
    return data[0] if data else None


def any_number(word: str) -> float:
    return float(word.replace(",", "."))


def any_column_number(_reader: object, word: str) -> float:
    return float(word)


def any_columns(columns: Sequence[object], values: Sequence[object]) -> object:
    return zip(columns, values, strict=True)


def any_names(fields: Sequence[Any], message: Any) -> object:
    """The names of a message, also where two are alike."""
    for field in fields:
        if field.path == "name":
            return attrgetter("name"), list(message.name)
    return None


def any_setting(offered: object, wanted: Mapping[object, int]) -> object:
    return dict(wanted)


def any_text(text: str) -> str:
    return text


def any_path(scanner: object, path: object, line: int) -> object:
    return path


def any_status(folder: Path) -> object:
    return json.loads((folder / "status.json").read_text())


# Where, what, and how it is broken.
FAULTS: dict[str, tuple[str, str, Breaking]] = {
    "bags": ("biosensor_gateway.recording.xdf.writing", "footer", always(b"")),
    "ble_heart_rate": (
        "tests.fuzz.targets.ble_heart_rate",
        "parse_battery_level",
        instead(any_byte),
    ),
    "bluetooth_health": (
        f"{DEVICES}.bluetooth_health.driver.services",
        "_celsius",
        always([0.0, 0.0]),
    ),
    "control_request": (
        "biosensor_gateway.agent.control_server.ControlServer",
        "_is_token",
        always(True),
    ),
    "counters": ("biosensor_common.topic_text", "_finite", instead(float)),
    "emotiv_cortex": (
        f"{DEVICES}.emotiv_insight.driver.protocol",
        "_labelled",
        instead(any_columns),
    ),
    "empatica_e4": (f"{DEVICES}.empatica_e4.driver.protocol", "_number", instead(any_number)),
    "line_sensor": (
        f"{DEVICES}.line_sensor.driver.protocol.csv.CsvReader",
        "_number",
        instead(any_column_number),
    ),
    "lsl_config": ("biosensor_gateway.recording.lsl_api_cfg.LslFile", "adapt", always(None)),
    "lsl_header": ("biosensor_common.lsl_header", "read_channels", always(NO_CHANNELS)),
    "movesense": (
        f"{DEVICES}.movesense.driver.timeline.PacketSeries",
        "_missing",
        always(-1),
    ),
    "naming": ("biosensor_common.naming", "_escape", instead(any_text)),
    "polar_control": ("tests.fuzz.targets.polar_control", "choose", instead(any_setting)),
    "polar_frames": (
        f"{DEVICES}.polar_h10.driver.protocol.timeline",
        "RATE_TOLERANCE",
        lambda _: inf,
    ),
    "ros_to_lsl": ("lsl_to_ros.ros_to_lsl.layout", "_names_in", instead(any_names)),
    "settings": ("biosensor_gateway.settings.toml_lines._Scanner", "_note", instead(any_path)),
    "shimmer3": (
        f"{DEVICES}.shimmer.driver.protocol.ShimmerProtocol",
        "feed",
        forgets_what_it_holds,
    ),
    "status": ("tests.fuzz.targets.status", "read_status", instead(any_status)),
    "vernier": (
        f"{DEVICES}.vernier_respiration_belt.driver.packets.PacketParser",
        "feed",
        forgets_what_it_holds,
    ),
    "xdf": ("biosensor_gateway.recording.xdf.container", "_damage", ends_too_late),
    "xdf_export": ("biosensor_gateway.recording.export.csv.wide", "batches", loses_the_last),
    "zephyr": (f"{DEVICES}.zephyr.driver.frames.FrameParser", "feed", forgets_what_it_holds),
}


def owner(path: str) -> Any:
    """Import a module, or a class of one."""
    try:
        return importlib.import_module(path)
    except ImportError:
        module, _, name = path.rpartition(".")
        return getattr(importlib.import_module(module), name)


@pytest.mark.parametrize("name", NAMES)
def test_a_broken_reader_is_found(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    target = load(name)
    path, attribute, breaking = FAULTS[name]
    place = owner(path)
    monkeypatch.setattr(place, attribute, breaking(getattr(place, attribute)))
    with strictly(), pytest.raises(Exception):  # noqa: B017 - anything is a find
        for each in inputs(CORPUS / name):
            target.check(each.read_bytes())
