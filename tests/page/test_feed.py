"""What the agent feeds to the page is what it sends; and nobody who reads it badly disturbs it."""

from __future__ import annotations

import asyncio
import json
import socket
from typing import Any

import numpy as np
import pylsl
import pytest

from biosensor_common.errors import TransportError
from biosensor_common.spec import DeviceIdentity
from biosensor_gateway.agent import control, status_file
from biosensor_gateway.agent.feed import MAX_READERS, MAX_WAITING_BYTES, Feed
from biosensor_gateway.agent.feed_frames import HEAD, FrameKind, Samples, read_count, read_samples
from biosensor_gateway.devices.registry import declaration
from biosensor_gateway.page.agent_client import AgentLink
from biosensor_gateway.streaming.sink import DeviceSink
from tests.page.conftest import DEADLINE_S, Programs
from tests.rigs.polling import until

ECG = "zephyr-virtual-ecg"
ALL_SAMPLES = 1 << 16


class Taken:
    """What a link was told."""

    def __init__(self, programs: Programs) -> None:
        self.status: Any = None
        self.was_away = False
        self.samples: list[Samples] = []
        self.link = AgentLink(programs.folder, self._note, self.samples.append, print)

    def _note(self, status: Any) -> None:
        self.status = status
        self.was_away = self.was_away or status is None

    def stamps(self, source_id: str) -> list[float]:
        return [t for each in self.samples if each.source_id == source_id for t in each.stamps]

    def values(self, source_id: str) -> list[float]:
        return [
            float(v) for each in self.samples if each.source_id == source_id for (v,) in each.values
        ]


@pytest.mark.seam
async def test_it_is_what_a_recorder_gets_to_the_last_bit(programs: Programs) -> None:
    programs.start("run", "--simulate", "zephyr")
    taken = Taken(programs)
    following = asyncio.create_task(taken.link.run())
    try:
        await until(lambda: taken.stamps(ECG))
        found = await asyncio.to_thread(pylsl.resolve_byprop, "source_id", ECG, 1, DEADLINE_S)
        inlet = pylsl.StreamInlet(found[0])
        inlet.open_stream(DEADLINE_S)
        values: list[float] = []
        stamps: list[float] = []

        def enough_has_come() -> bool:
            rows, more = inlet.pull_chunk(max_samples=ALL_SAMPLES)
            values.extend(value for (value,) in rows)
            stamps.extend(more)
            return len(stamps) > 900

        await until(enough_has_come)
        inlet.close_stream()
        await until(lambda: stamps[-1] in taken.stamps(ECG))
        first = taken.stamps(ECG).index(stamps[0])
        assert taken.values(ECG)[first:][: len(values)] == values
        assert taken.stamps(ECG)[first:][: len(stamps)] == stamps
        assert taken.status is not None
        assert taken.status.devices[0].sensor == "zephyr"
    finally:
        following.cancel()
        await asyncio.gather(following, return_exceptions=True)


@pytest.mark.nightly
async def test_it_goes_on_with_the_agent_that_comes_after_a_kill(programs: Programs) -> None:
    process = programs.start("run", "--simulate", "zephyr")
    taken = Taken(programs)
    following = asyncio.create_task(taken.link.run())
    try:
        await until(lambda: taken.stamps(ECG))
        process.kill()
        await until(lambda: taken.status is None)
        before = len(taken.stamps(ECG))
        programs.start("run", "--simulate", "zephyr")
        await until(lambda: len(taken.stamps(ECG)) > before + 100)
        assert taken.was_away
    finally:
        following.cancel()
        await asyncio.gather(following, return_exceptions=True)


@pytest.mark.nightly
def test_readers_that_do_not_read_cost_the_agent_nothing(programs: Programs) -> None:
    programs.start("run", "--simulate", "zephyr")
    stuck: list[socket.socket] = []
    try:
        _wait_for_agent(programs)
        place = json.loads((programs.folder / control.CONTROL_FILE).read_text())
        request = control.line({"token": place["token"], "command": "feed"})
        for _ in range(MAX_READERS):
            connection = socket.create_connection((control.HOST, place["port"]))
            connection.sendall(request)
            assert control.json_object(connection.makefile("rb").readline())
            stuck.append(connection)
        with socket.create_connection((control.HOST, place["port"])) as one_more:
            one_more.sendall(request)
            answer = control.json_object(one_more.makefile("rb").readline())
            assert answer is not None
            assert "programs already show the agent's data" in answer["problem"]
        (device,) = status_file.read_status(programs.folder)["devices"]
        before = device["streams"][ECG]["pushed"]
        while device["streams"][ECG]["pushed"] < before + 1000:
            (device,) = status_file.read_status(programs.folder)["devices"]
        assert device["streams"][ECG]["lost"] == 0
        assert device["connections"] == 1
        # With all of them waiting, it ends as it should.
        assert control.ask(programs.folder, "stop")["process"]
    finally:
        for connection in stuck:
            connection.close()


async def test_what_a_slow_reader_misses_is_the_oldest_and_is_counted() -> None:
    feed = Feed()
    sink = DeviceSink(DeviceIdentity("zephyr", "1"), declaration("zephyr"))
    feed.watch(sink)
    assert sink.tap is not None
    sink.tap("ecg", [0.0], [0.0])
    reading = feed.conversation({})
    assert await anext(reading) == b""
    block = np.arange(10_000, dtype=np.float32)
    for number in range(100):
        sink.tap("ecg", block + 10_000 * number, [float(number)] * len(block))
    frames = list(_frames(await anext(reading)))
    await reading.aclose()
    assert frames[0][0] is FrameKind.DROPPED
    kept = [read_samples(content) for kind, content in frames if kind is FrameKind.SAMPLES]
    assert sum(len(content) for _, content in frames) <= MAX_WAITING_BYTES
    assert kept[-1].values[-1, 0] == 999_999
    assert read_count(frames[0][1]) + sum(len(each.stamps) for each in kept) == 1_000_000
    values = np.concatenate([each.values[:, 0] for each in kept])
    assert (np.diff(values) == 1).all()


async def test_a_new_reader_gets_the_newest_sample_of_each_stream() -> None:
    feed = Feed()
    worn, withdrawn, removed = (DeviceIdentity("zephyr", each) for each in "123")
    for each in (worn, withdrawn, removed):
        sink = DeviceSink(each, declaration("zephyr"))
        feed.watch(sink)
        assert sink.tap is not None
        sink.tap("bat", [88.0, 87.0], [3.0, 4.0])
        sink.tap("ecg", np.zeros((2, 1)), [5.0, 6.0])
    facts = {"sensor": "zephyr", "participant": "", "label": "", "paused": False}
    devices = [facts | {"unit": "1"}, facts | {"unit": "2", "paused": True}]
    feed.send_status({"devices": devices})
    reading = feed.conversation({})
    frames = list(_frames(await anext(reading)))
    await reading.aclose()
    got = [read_samples(content) for kind, content in frames if kind is FrameKind.SAMPLES]
    told = {each.source_id: (each.stamps.tolist(), each.values.tolist()) for each in got}
    # Nothing of who has withdrawn, and of a sensor that is not there any more.
    assert told == {"zephyr-1-bat": ([4.0], [[87.0]]), "zephyr-1-ecg": ([6.0], [[0.0]])}


async def test_one_reader_too_many_is_refused_with_a_sentence() -> None:
    feed = Feed()
    readers = [feed.conversation({}) for _ in range(MAX_READERS)]
    for reader in readers:
        await anext(reader)
    with pytest.raises(TransportError, match="close one"):
        await anext(feed.conversation({}))
    await readers[0].aclose()
    await anext(feed.conversation({}))


@pytest.mark.parametrize("content", [b"", b"\0" * 7, b"\xff" * 40])
def test_a_frame_that_is_none_is_refused(content: bytes) -> None:
    with pytest.raises(ValueError):
        read_samples(content)
    with pytest.raises(ValueError):
        read_count(content + b"1")


def _frames(sent: bytes) -> list[tuple[FrameKind, bytes]]:
    frames: list[tuple[FrameKind, bytes]] = []
    while sent:
        length, kind = HEAD.unpack_from(sent)
        frames.append((FrameKind(kind), sent[HEAD.size : HEAD.size + length]))
        sent = sent[HEAD.size + length :]
    return frames


def _wait_for_agent(programs: Programs) -> None:
    programs.call("wait-ready", "--timeout", "60")
