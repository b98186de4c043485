"""Who has withdrawn, by name and on disk."""

from __future__ import annotations

import asyncio
import json
import os
import threading
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from datetime import datetime, timedelta, timezone
from pathlib import Path
from typing import Any

import pytest
from structlog.testing import capture_logs

from biosensor_common.errors import ConfigError, ConfigReason
from biosensor_common.spec import DeviceIdentity
from biosensor_gateway.agent.pauses import (
    PAUSED_FILE,
    Pause,
    PauseCommands,
    load_pauses,
    save_pauses,
)
from biosensor_gateway.agent.selection import chosen, device_name
from biosensor_gateway.devices.registry import declaration
from biosensor_gateway.streaming.sink import DeviceSink

DEADLINE_S = 30.0
SINCE = datetime(2026, 3, 29, 9, 30, 15, tzinfo=timezone(timedelta(hours=2)))
H10 = "polar_h10"
LEFT = DeviceIdentity(H10, "A1", "p01", "left")
RIGHT = DeviceIdentity(H10, "B2", "p01", "right")
BELT = DeviceIdentity("vernier_respiration_belt", "0K2002Z5", "p02")
PLAIN = DeviceIdentity(H10, "C 3")


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("polar_h10/A1", LEFT),
        ("left", LEFT),
        ("right", RIGHT),
        ("p02", BELT),
        ("vernier_respiration_belt", BELT),
        ("polar_h10/C 3", PLAIN),
    ],
)
def test_a_device_has_several_names(name: str, expected: DeviceIdentity) -> None:
    assert chosen(name, [LEFT, RIGHT, BELT, PLAIN]) is expected


@pytest.mark.parametrize("name", ["polar_h10", "p01"])
def test_of_several_none_is_chosen_and_all_are_listed(name: str) -> None:
    with pytest.raises(ConfigError) as caught:
        chosen(name, [LEFT, RIGHT, BELT])
    assert caught.value.reason is ConfigReason.WRONG_VALUE
    assert str(caught.value) == (
        f"several devices are called '{name}'; "
        "say which one: polar_h10/A1 (p01 left), polar_h10/B2 (p01 right)"
    )


@pytest.mark.parametrize("name", ["", "zephyr", "A1", "polar_h10/", "LEFT", "polar_h10/A1 "])
def test_of_an_unknown_name_all_devices_are_listed(name: str) -> None:
    with pytest.raises(ConfigError) as caught:
        chosen(name, [LEFT, PLAIN])
    assert caught.value.reason is ConfigReason.NOT_FOUND
    assert str(caught.value).endswith("there are: polar_h10/A1 (p01 left), polar_h10/C 3")


def test_without_devices_it_says_so() -> None:
    with pytest.raises(ConfigError, match="there is none"):
        chosen("polar_h10", [])


def test_what_was_saved_is_loaded(tmp_path: Path) -> None:
    folder = tmp_path / "not" / "there"
    assert load_pauses(folder) == []
    pauses = [Pause(LEFT, SINCE), Pause(PLAIN, SINCE)]
    save_pauses(folder, pauses)
    assert load_pauses(folder) == pauses
    assert [path.name for path in folder.iterdir()] == [PAUSED_FILE]
    save_pauses(folder, [])
    assert list(folder.iterdir()) == []
    save_pauses(folder, [])


def test_a_folder_that_cannot_be_written_keeps_what_it_has(tmp_path: Path) -> None:
    save_pauses(tmp_path, [Pause(LEFT, SINCE)])
    (tmp_path / f"{PAUSED_FILE}.{os.getpid()}").mkdir()
    with pytest.raises(OSError, match=r"paused\.json"):
        save_pauses(tmp_path, [Pause(LEFT, SINCE), Pause(BELT, SINCE)])
    assert load_pauses(tmp_path) == [Pause(LEFT, SINCE)]


ENTRY = {"sensor": H10, "unit": "A1", "participant": "", "label": "", "since": SINCE.isoformat()}


@pytest.mark.parametrize(
    "text",
    [
        "",
        "{",
        "[]",
        "{}",
        '{"paused": 1}',
        '{"paused": [1]}',
        json.dumps({"paused": [{**ENTRY, "unit": 3}]}),
        json.dumps({"paused": [{**ENTRY, "since": "yesterday"}]}),
        json.dumps({"paused": [{key: ENTRY[key] for key in ENTRY if key != "label"}]}),
        "[" * 5000,
        "\xff\xfe",
    ],
)
def test_from_a_damaged_file_nobody_is_streamed(tmp_path: Path, text: str) -> None:
    (tmp_path / PAUSED_FILE).write_text(text, encoding="latin-1")
    with pytest.raises(ConfigError) as caught:
        PauseCommands(tmp_path, list)
    assert caught.value.reason is ConfigReason.UNREADABLE
    assert str(tmp_path / PAUSED_FILE) in str(caught.value)
    assert "remove it if nobody has" in str(caught.value)


@pytest.mark.parametrize(
    ("paused", "now", "holds"),
    [
        (LEFT, LEFT, True),
        # Another strap continues the streams of that person.
        (LEFT, DeviceIdentity(H10, "Z9", "p01", "left"), True),
        (LEFT, DeviceIdentity(H10, "A1", "p01"), True),
        (LEFT, DeviceIdentity(H10, "A1"), True),
        (PLAIN, DeviceIdentity(H10, "C 3", "p07"), True),
        # Another person wears it.
        (LEFT, DeviceIdentity(H10, "A1", "p02", "left"), False),
        (LEFT, RIGHT, False),
        (PLAIN, DeviceIdentity(H10, "D4"), False),
        (PLAIN, DeviceIdentity("zephyr", "C 3"), False),
    ],
)
def test_a_pause_follows_the_person_and_the_device(
    paused: DeviceIdentity, now: DeviceIdentity, holds: bool
) -> None:
    assert Pause(paused, SINCE).holds_for(now) is holds


def test_who_had_withdrawn_is_paused_from_the_start_and_it_is_said(tmp_path: Path) -> None:
    save_pauses(tmp_path, [Pause(LEFT, SINCE)])
    sinks = [DeviceSink(LEFT, declaration(LEFT.sensor)), DeviceSink(BELT, declaration(BELT.sensor))]
    with capture_logs() as logs:
        PauseCommands(tmp_path, lambda: sinks)
    assert [sink.is_paused for sink in sinks] == [True, False]
    assert [sink.gate.since for sink in sinks] == [SINCE.timestamp(), None]
    (said,) = logs
    assert (said["log_level"], said["unit"]) == ("warning", "A1")
    assert said["since"] == "2026-03-29T09:30:15+02:00"
    assert said["resume_with"] == "biosensor-gateway resume polar_h10/A1"


def _left() -> list[DeviceSink]:
    return [DeviceSink(LEFT, declaration(LEFT.sensor))]


async def test_pause_and_resume_are_kept(tmp_path: Path) -> None:
    sinks = [DeviceSink(LEFT, declaration(LEFT.sensor)), DeviceSink(BELT, declaration(BELT.sensor))]
    commands = PauseCommands(tmp_path, lambda: sinks).commands
    assert await ask(commands, "pause", "left") == ("polar_h10/A1", True, None)
    assert await ask(commands, "pause", "left") == ("polar_h10/A1", False, None)
    assert await ask(commands, "pause", "p02") == (device_name(BELT), True, None)
    kept = load_pauses(tmp_path)
    assert [each.identity for each in kept] == [LEFT, BELT]
    assert abs(datetime.now().astimezone() - kept[0].since) < timedelta(minutes=5)
    assert await ask(commands, "resume", "left") == ("polar_h10/A1", True, None)
    assert await ask(commands, "resume", "left") == ("polar_h10/A1", False, None)
    assert [each.identity for each in load_pauses(tmp_path)] == [BELT]
    assert [sink.is_paused for sink in sinks] == [False, True]


async def test_a_pause_of_somebody_who_is_not_in_the_settings_is_kept(tmp_path: Path) -> None:
    save_pauses(tmp_path, [Pause(BELT, SINCE)])
    commands = PauseCommands(tmp_path, _left).commands
    await ask(commands, "pause", "left")
    await ask(commands, "resume", "left")
    assert load_pauses(tmp_path) == [Pause(BELT, SINCE)]


async def test_what_cannot_be_kept_is_done_and_said(tmp_path: Path) -> None:
    sink = DeviceSink(LEFT, declaration(LEFT.sensor))
    commands = PauseCommands(tmp_path, lambda: [sink]).commands
    blocked = tmp_path / f"{PAUSED_FILE}.{os.getpid()}"
    blocked.mkdir()
    _, changed, problem = await ask(commands, "pause", "left")
    assert sink.is_paused
    assert changed
    assert problem is not None
    assert str(tmp_path / PAUSED_FILE) in problem
    blocked.rmdir()
    # Asked again, it is written.
    assert await ask(commands, "pause", "left") == ("polar_h10/A1", False, None)
    assert len(load_pauses(tmp_path)) == 1


@pytest.mark.nightly
async def test_an_answer_does_not_wait_for_what_is_slow(tmp_path: Path) -> None:
    sink = DeviceSink(LEFT, declaration(LEFT.sensor))
    commands = PauseCommands(tmp_path, lambda: [sink]).commands
    released = threading.Event()
    # As when every thread waits for a disk or a port.
    with ThreadPoolExecutor(1) as threads:
        asyncio.get_running_loop().set_default_executor(threads)
        threads.submit(released.wait)
        try:
            answer = await asyncio.wait_for(commands["pause"]({"device": "left"}), DEADLINE_S)
        finally:
            released.set()
        assert sink.is_paused
        assert (answer["changed"], answer["pending"]) == (True, True)
        assert str(tmp_path / PAUSED_FILE) in answer["problem"]
        assert await ask(commands, "pause", "left") == ("polar_h10/A1", False, None)
    assert [each.identity for each in load_pauses(tmp_path)] == [LEFT]


async def test_a_request_without_a_name_is_refused(tmp_path: Path) -> None:
    commands = PauseCommands(tmp_path, _left).commands
    with pytest.raises(ConfigError, match="'device' is not a text"):
        await commands["pause"]({"device": 7})


async def ask(commands: Mapping[str, Any], name: str, device: str) -> tuple[str, bool, str | None]:
    answer = first = await commands[name]({"device": device})
    while answer["pending"]:
        answer = await commands[name]({"device": device})
    return answer["device"], first["changed"], answer["problem"]
