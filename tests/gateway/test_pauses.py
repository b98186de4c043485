"""Pauses: which device is meant, who has withdrawn, and what is held back."""

from __future__ import annotations

import asyncio
import json
import os
import threading
from collections.abc import Generator, Mapping
from concurrent.futures import ThreadPoolExecutor
from datetime import datetime, timedelta, timezone
from pathlib import Path
from typing import Any

import pylsl
import pytest
from hypothesis import given
from hypothesis import strategies as st
from structlog.testing import capture_logs

from biosensor_common import naming
from biosensor_common.errors import ConfigError, ConfigReason
from biosensor_common.spec import DeviceIdentity, DeviceInfo
from biosensor_gateway.agent.device_states import chosen, device_name
from biosensor_gateway.agent.pauses import (
    PAUSED_FILE,
    Pause,
    PauseCommands,
    load_pauses,
    save_pauses,
)
from biosensor_gateway.devices.registry import declaration
from biosensor_gateway.streaming import outlets as outlets_module
from biosensor_gateway.streaming.counters import Counters
from biosensor_gateway.streaming.sink import DeviceSink
from biosensor_gateway.streaming.stages import RESUME_GUARD_S, PauseGate
from tests.rigs.gateway import inlet
from tests.rigs.polling import wait_until

# What a pause holds back, sample by sample: real outlets, real inlets.

AHEAD_S = 20.0
"""Stamps so far ahead are still on the LSL clock; so tests need not wait for a guard to end."""


@pytest.fixture
def sink(unit: str) -> Generator[DeviceSink]:
    opened = DeviceSink(DeviceIdentity("empatica_e4", unit), declaration("empatica_e4"))
    opened.open(DeviceInfo(), {})
    yield opened
    opened.close()


def source(sink: DeviceSink, data_name: str) -> str:
    return naming.source_id(sink.identity, data_name)


def counters(sink: DeviceSink, data_name: str) -> Counters:
    return sink.counters[source(sink, data_name)]


def pulled(reader: pylsl.StreamInlet, last: object) -> list[object]:
    """Return the first channel of all that comes up to a value."""
    values: list[object] = []

    def has_come() -> bool:
        samples, _ = reader.pull_chunk(timeout=0.0)
        values.extend(row[0] for row in samples)
        return last in values

    wait_until(has_come)
    return values


@pytest.mark.nightly
def test_not_one_sample_of_a_pause_is_sent(sink: DeviceSink) -> None:
    reader = inlet(source(sink, "bvp"))
    sink.emit_at("bvp", [1.0, 2.0], [pylsl.local_clock() - 0.2, pylsl.local_clock() - 0.1])
    before_s = pylsl.local_clock()
    sink.pause()
    # Measured before, and in work when the pause began.
    sink.emit_at("bvp", [3.0], [before_s - 0.05])
    sink.emit_at("bvp", [4.0, 5.0], [before_s, before_s + AHEAD_S])
    sink.resume()
    after_s = pylsl.local_clock()
    # Measured in the pause, and in work when it ended; the last one is as late as a guard is.
    guard_ends_s = after_s + RESUME_GUARD_S
    sink.emit_at("bvp", [6.0, 7.0], [before_s + 1e-4, guard_ends_s - 0.1])
    # Of one packet, what was measured later is sent.
    sink.emit_at("bvp", [8.0, 9.0, 10.0], [after_s, guard_ends_s, guard_ends_s + 0.1])
    assert pulled(reader, 10.0) == [1.0, 2.0, 9.0, 10.0]
    counted = counters(sink, "bvp")
    assert (counted.pushed, counted.withheld, counted.refused, counted.lost) == (4, 6, 0, 0)
    assert counted.last_stamp == guard_ends_s + 0.1


@pytest.mark.nightly
def test_withheld_samples_do_not_move_the_stamps_of_those_after(sink: DeviceSink) -> None:
    reader = inlet(source(sink, "bvp"))
    sink.pause()
    now = pylsl.local_clock()
    sink.emit_at("bvp", [1.0], [now + AHEAD_S])
    sink.resume()
    stamp = pylsl.local_clock() + RESUME_GUARD_S + 0.5
    sink.emit_at("bvp", [2.0], [stamp])
    assert reader.pull_sample(timeout=20.0) == ([2.0], stamp)


@pytest.mark.parametrize("rows", [[[1.0, 2.0, 3.0]], [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]])
def test_samples_of_several_channels_are_withheld_whole(
    sink: DeviceSink, rows: list[list[float]]
) -> None:
    sink.pause()
    sink.emit_at("acc", rows, [pylsl.local_clock()] * len(rows))
    assert counters(sink, "acc") == Counters(withheld=len(rows))


@pytest.mark.nightly
def test_text_is_withheld_as_well(sink: DeviceSink) -> None:
    reader = inlet(source(sink, "tag"))
    now = pylsl.local_clock()
    sink.observe(now, now)
    sink.emit_text("tag", "before", now)
    sink.pause()
    sink.emit_text("tag", "during", pylsl.local_clock())
    sink.emit_text("tag", "during", pylsl.local_clock() + AHEAD_S)
    sink.resume()
    sink.emit_text("tag", "in work", pylsl.local_clock())
    sink.emit_text("tag", "after", pylsl.local_clock() + RESUME_GUARD_S + 0.1)
    assert pulled(reader, "after") == ["before", "after"]
    assert (counters(sink, "tag").pushed, counters(sink, "tag").withheld) == (2, 3)


@pytest.mark.nightly
def test_states_that_wait_for_a_receiver_are_withdrawn_too(
    monkeypatch: pytest.MonkeyPatch, unit: str
) -> None:
    monkeypatch.setattr(outlets_module, "ATTACH_TIME_S", 0.0)
    sink = DeviceSink(DeviceIdentity("empatica_e4", unit), declaration("empatica_e4"))
    sink.open(DeviceInfo(), {})
    sink.emit_at("bat", [71.0], [pylsl.local_clock()])
    sink.pause()
    assert counters(sink, "bat") == Counters(withheld=1)
    reader = inlet(source(sink, "bat"))
    sink.release()
    sink.emit_at("bat", [72.0], [pylsl.local_clock()])
    sink.resume()
    sink.release()
    sink.emit_at("bat", [73.0], [pylsl.local_clock() + RESUME_GUARD_S + 0.1])

    def released() -> bool:
        sink.release()
        return counters(sink, "bat").pushed == 1

    wait_until(released)
    assert pulled(reader, 73.0) == [73.0]
    assert counters(sink, "bat").withheld == 2
    sink.close()


def test_outlets_of_a_paused_device_come_with_it_and_stay_empty(unit: str) -> None:
    sink = DeviceSink(DeviceIdentity("empatica_e4", unit), declaration("empatica_e4"))
    sink.pause()
    sink.open(DeviceInfo(), {})
    sink.emit_at("bvp", [1.0], [pylsl.local_clock()])
    assert counters(sink, "bvp") == Counters(withheld=1)
    sink.close()


def test_a_second_pause_does_not_shorten_the_first(sink: DeviceSink) -> None:
    sink.pause()
    sink.pause()
    assert sink.is_paused
    sink.resume()
    sink.resume()
    assert not sink.is_paused


def test_what_does_not_fit_its_times_is_refused_and_nothing_else(sink: DeviceSink) -> None:
    sink.pause()
    sink.resume()
    now = pylsl.local_clock()
    sink.emit_at("bvp", [1.0], [now, now + AHEAD_S])
    assert counters(sink, "bvp") == Counters(refused=2)


def test_losses_of_a_pause_are_none(sink: DeviceSink) -> None:
    sink.emit_at("bvp", [1.0], [pylsl.local_clock()])
    sink.lost("bvp", 5)
    sink.pause()
    for ahead_s in (0.0, 1.0):
        sink.emit_at("bvp", [1.0], [pylsl.local_clock() + ahead_s])
    sink.lost("bvp", 1000)
    # Before the first sample there is nothing to tell from when it is missing.
    sink.lost("acc", 1000)
    assert counters(sink, "bvp").lost == 5
    assert counters(sink, "acc").lost == 0


def test_of_a_gap_that_was_partly_paused_the_rest_is_lost(sink: DeviceSink) -> None:
    now = pylsl.local_clock()
    sink.emit_at("bvp", [1.0], [now - 10.0])
    sink.pause()
    sink.resume()
    # Ten seconds unpaused, then a pause and its guard of one second together.
    sink.emit_at("bvp", [2.0], [now + RESUME_GUARD_S + 0.001])
    sink.lost("bvp", 1100)
    assert counters(sink, "bvp").lost == pytest.approx(1000, abs=15)


@given(
    edges=st.lists(st.integers(0, 1000), min_size=4, max_size=4, unique=True).map(sorted),
    span=st.lists(st.integers(-10, 1010), min_size=2, max_size=2, unique=True).map(sorted),
)
def test_the_share_of_a_span_is_what_lies_in_the_pauses(edges: list[int], span: list[int]) -> None:
    withheld = PauseGate()
    for begin, end in (edges[:2], edges[2:]):
        withheld.begin(float(begin * 10))
        withheld.end(end * 10 - RESUME_GUARD_S)
    inside = sum(
        any(begin * 10 <= moment < end * 10 for begin, end in (edges[:2], edges[2:]))
        for moment in range(span[0] * 10, span[1] * 10)
    )
    assert withheld.share(span[0] * 10.0, span[1] * 10.0) == pytest.approx(
        inside / (span[1] * 10 - span[0] * 10)
    )


# Who has withdrawn, by name and on disk.
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
        f"several devices have the name '{name}'; choose one: polar_h10/A1 (p01 left), "
        "polar_h10/B2 (p01 right)"
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
    with pytest.raises(ConfigError, match="'device' is not text"):
        await commands["pause"]({"device": 7})


async def ask(commands: Mapping[str, Any], name: str, device: str) -> tuple[str, bool, str | None]:
    answer = first = await commands[name]({"device": device})
    while answer["pending"]:
        answer = await commands[name]({"device": device})
    return answer["device"], first["changed"], answer["problem"]


# Which device is meant by a name.
FIRST = DeviceIdentity("polar_h10", "A1", "p01", "left")
SECOND = DeviceIdentity("zephyr", "B2", "p02")


@pytest.mark.parametrize(
    ("name", "meant"),
    [("polar_h10/A2", "polar_h10/A1"), ("polarh10", "polar_h10"), ("lefft", "left")],
)
def test_a_misspelt_name_is_guessed(name: str, meant: str) -> None:
    with pytest.raises(ConfigError, match=rf"name '{name}' \(did you mean '{meant}'\?\); there"):
        chosen(name, [FIRST, SECOND])
