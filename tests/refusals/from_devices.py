"""Provokes what an agent, its markers, the features and the page refuse."""

# Parts stand in for what is around the part that refuses, and some of that is private.
# pyright: reportPrivateUsage=false, reportUnknownLambdaType=false, reportUnknownArgumentType=false
# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false

from __future__ import annotations

import math
import socket
from collections.abc import Sequence
from concurrent.futures import Future
from typing import Any, NoReturn

import numpy as np
import pylsl
import pytest

from biosensor_common.lsl import inlet as inlet_module
from biosensor_common.refusal import Refusal, Refusals
from biosensor_common.spec import DeviceIdentity, DeviceInfo
from biosensor_gateway.cli import agent_process
from biosensor_gateway.cli.agent_process import FeatureProcess
from biosensor_gateway.devices.polar_h10.driver.emitter import PolarEmitter
from biosensor_gateway.devices.registry import declaration
from biosensor_gateway.features.live import Live
from biosensor_gateway.page.network import stream_list as listing_module
from biosensor_gateway.page.network.network_stream import Placer
from biosensor_gateway.page.network.stream_list import StreamList
from biosensor_gateway.page.network.view import Viewer, _clock_note
from biosensor_gateway.settings.models import LslSettings
from biosensor_gateway.streaming import outlets
from biosensor_gateway.streaming.marker_stream import MarkerKind, MarkerStream
from biosensor_gateway.streaming.outlets import MAX_WAITING, Outlet, spare_outlet
from biosensor_gateway.streaming.sink import DeviceSink
from tests.polar_h10.test_emitter import ECG, arrival, ecg
from tests.refusals.provoked import Shown, fake, in_status, provokes
from tests.rigs.emitter_sink import EmitterSink
from tests.rigs.memory_links import MemoryOutlet
from tests.rigs.virtual_time import SetClock
from tests.ros.test_aliases import Info

NOW_S = 1000.0


class Unheard(MemoryOutlet):
    def have_consumers(self) -> bool:
        return False


def sink(patch: pytest.MonkeyPatch) -> DeviceSink:
    patch.setattr(outlets, "LslOutlet", MemoryOutlet)
    opened = DeviceSink(DeviceIdentity("zephyr", "U1"), declaration("zephyr"), SetClock(NOW_S))
    opened.open(DeviceInfo(), {})
    return opened


def emitted(patch: pytest.MonkeyPatch, data: str, samples: Any, *stamps: float) -> Shown:
    zephyr = sink(patch)
    zephyr.emit_at(data, samples, list(stamps))
    return in_status(zephyr.refused[f"zephyr-U1-{data}"])


@provokes(Refusal.WRONG_SHAPE)
def wrong_shape(patch: pytest.MonkeyPatch) -> Shown:
    return emitted(patch, "ecg", [[1.0, 2.0]], NOW_S)


@provokes(Refusal.LATE)
def late(patch: pytest.MonkeyPatch) -> Shown:
    patch.setattr(outlets, "LslOutlet", MemoryOutlet)
    strap = DeviceSink(DeviceIdentity("polar_h10", "U1"), declaration("polar_h10"), SetClock(NOW_S))
    strap.open(DeviceInfo(), {"ecg": 130.0, "acc": 50.0})
    for second in range(5):
        strap.observe(float(second), NOW_S + second)
    # A heart rate is the first of what had waited, and nothing tells so before the next packet.
    strap.emit_on_arrival("hr", 60.0, NOW_S + 12.0)
    strap.observe(8.0, NOW_S + 12.01)
    return in_status(strap.refused["polar_h10-U1-hr"])


@provokes(Refusal.BACKWARDS)
def backwards(patch: pytest.MonkeyPatch) -> Shown:
    return emitted(patch, "ecg", [1.0], math.nan)


@provokes(Refusal.NOT_LSL_TIME)
def not_lsl_time(patch: pytest.MonkeyPatch) -> Shown:
    return emitted(patch, "ecg", [1.0], NOW_S + 1e6)


@provokes(Refusal.INFINITE)
def infinite(patch: pytest.MonkeyPatch) -> Shown:
    return emitted(patch, "ecg", [math.inf], NOW_S)


@provokes(Refusal.NO_VALUE)
def no_value(patch: pytest.MonkeyPatch) -> Shown:
    return emitted(patch, "hr", [math.nan], NOW_S)


@provokes(Refusal.OUT_OF_RANGE)
def out_of_range(patch: pytest.MonkeyPatch) -> Shown:
    return emitted(patch, "hr", [300.0], NOW_S)


@provokes(Refusal.IMPLAUSIBLE)
def implausible(patch: pytest.MonkeyPatch) -> Shown:
    return emitted(patch, "br", [500.0], NOW_S)


@provokes(Refusal.FLAT)
def flat(patch: pytest.MonkeyPatch) -> Shown:
    zephyr = sink(patch)
    for second in range(12):
        zephyr.emit_at(
            "ecg", np.full(250, 512.0), (NOW_S - 12 + second + np.arange(250) / 250).tolist()
        )
    return in_status(zephyr.refused["zephyr-U1-ecg"])


@provokes(Refusal.PAUSED)
def paused(patch: pytest.MonkeyPatch) -> Shown:
    zephyr = sink(patch)
    zephyr.pause()
    zephyr.emit_at("ecg", [1.0, 2.0], [NOW_S, NOW_S])
    return in_status(zephyr.refused["zephyr-U1-ecg"])


@provokes(Refusal.WAITED_TOO_LONG)
def waited_too_long(patch: pytest.MonkeyPatch) -> Shown:
    patch.setattr(outlets, "LslOutlet", Unheard)
    stream = declaration("zephyr").stream("bat")
    outlet = Outlet(stream, DeviceIdentity("zephyr", "U1"), DeviceInfo(), SetClock(NOW_S))
    for _ in range(MAX_WAITING + 1):
        outlet.push([50.0] * len(stream.channels), [NOW_S])
    return in_status(outlet.refusals)


@provokes(Refusal.LEFT_OUT)
def left_out(patch: pytest.MonkeyPatch) -> Shown:
    del patch
    strap = EmitterSink("polar_h10")
    emitter = PolarEmitter(strap)
    emitter.started(ECG, 130, 1.0)
    for _ in range(2):
        emitter.frame(ecg(0), arrival(0))
    return in_status(strap.refusals)


@provokes(Refusal.GARBLED)
def garbled(patch: pytest.MonkeyPatch) -> Shown:
    zephyr = sink(patch)
    zephyr.dropped_bytes += 3
    zephyr.release()
    return in_status(zephyr.refusals)


@provokes(Refusal.NO_OUTLET)
def no_outlet(patch: pytest.MonkeyPatch) -> Shown:
    def nameless() -> str:
        raise OSError

    patch.setattr(socket, "gethostname", nameless)
    refusals = Refusals()
    assert spare_outlet("markers", refusals) is None
    return in_status(refusals)


@provokes(Refusal.UNHEARD_MARKER)
def unheard_marker(patch: pytest.MonkeyPatch) -> Shown:
    patch.setattr(outlets, "LslOutlet", Unheard)
    stream = MarkerStream(SetClock(NOW_S))
    stream.open()
    stream.mark("start", "", MarkerKind.API, "")
    return in_status(stream.refusals)


class Immediate:
    """Runs what it is given at once."""

    def submit(self, work: Any, *arguments: Any, **options: Any) -> Future[Any]:
        future: Future[Any] = Future()
        future.set_result(work(*arguments, **options))
        return future


def features(
    patch: pytest.MonkeyPatch, kind: str, unit: str, stamps: Sequence[float], value: float
) -> Shown:
    """Have features computed of a signal of another program; they tell the agent's log."""
    live, said = computing(patch, kind, unit, stamps, value)
    assert said
    return in_status(live.refusals)


def computing(
    patch: pytest.MonkeyPatch, kind: str, unit: str, stamps: Sequence[float], value: float
) -> tuple[Live, list[str]]:
    info = pylsl.StreamInfo("strap", kind, 1, 130.0, "float32", "strap")
    channel = info.desc().append_child("channels").append_child("channel")
    channel.append_child_value("label", kind)
    channel.append_child_value("unit", unit)
    chunks = [([[value]] * len(stamps), list(stamps))]
    inlet = fake(
        pull_chunk=lambda *_: chunks.pop() if chunks else ([], []), close_stream=lambda: None
    )
    patch.setattr(inlet_module, "open_inlet", lambda *_, **__: inlet)
    patch.setattr("biosensor_gateway.features.live.LslOutlet", MemoryOutlet)
    said: list[str] = []
    now = [NOW_S]
    live = Live(fake(found=lambda _: None, refused=said.append), lambda: now[0])
    live._asking = Immediate()  # type: ignore[assignment]
    patch.setattr("biosensor_gateway.features.live._description", lambda _: info.as_xml())
    for _ in range(4):
        live.look([info])
        now[0] += 2.0
    live.read()
    return live, said


@provokes(Refusal.FEATURES_TWICE)
def features_twice(patch: pytest.MonkeyPatch) -> Shown:
    stamps = [NOW_S + 0.01, NOW_S + 0.02]
    live, said = computing(patch, "ECG", "microvolts", stamps, 1.0)
    (stage,) = live._stages.values()
    both = [
        fake(source_id=lambda: stage.sent_ids[0], uid=lambda uid=uid: uid, hostname=lambda: "vm")
        for uid in ("own", "other")
    ]
    alive = fake(among=lambda uids, _: set(uids))
    live.look_for_others(both[:1], alive)
    assert said == []
    live.look_for_others(both, alive)
    return in_status(live.refusals)


@provokes(Refusal.FEATURES_ENDED)
def features_ended(patch: pytest.MonkeyPatch) -> Shown:
    def missing(_: object) -> NoReturn:
        raise FileNotFoundError(2, "No such file or directory")

    patch.setattr(agent_process, "start_for", missing)
    refusals = Refusals(say=lambda _: process.end_soon())
    process = FeatureProcess(LslSettings(), refusals)
    process._keep()
    return in_status(refusals)


@provokes(Refusal.NO_FEATURES)
def no_features(patch: pytest.MonkeyPatch) -> Shown:
    return features(patch, "GSR", "", [], 0.0)


@provokes(Refusal.STAMPS_LEFT_OUT)
def stamps_left_out(patch: pytest.MonkeyPatch) -> Shown:
    return features(patch, "ECG", "microvolts", [NOW_S, NOW_S - 5.0, NOW_S + 0.1, NOW_S + 0.2], 1.0)


@provokes(Refusal.WRONG_RATE)
def wrong_rate(patch: pytest.MonkeyPatch) -> Shown:
    stamps = (NOW_S + np.arange(1600) / 90.0).tolist()
    return features(patch, "ECG", "microvolts", stamps, 1.0)


@provokes(Refusal.NO_FINITE_VALUE)
def no_finite_value(patch: pytest.MonkeyPatch) -> Shown:
    return features(patch, "ECG", "microvolts", [NOW_S, NOW_S + 0.01, NOW_S + 0.02], math.inf)


def problems(listing: StreamList) -> Shown:
    (sentence,) = Viewer().view(listing, 0, (), NOW_S).problems
    return Shown(1, sentence)


@provokes(Refusal.NOT_LISTED)
def not_listed(patch: pytest.MonkeyPatch) -> Shown:
    patch.setattr(listing_module, "MAX_STREAMS", 0)
    listing = StreamList()
    listing.update([pylsl.StreamInfo("a", "EEG", 1, 100.0, "float32", "a")], NOW_S)
    return problems(listing)


@provokes(Refusal.EITHER_SENDER)
def either_sender(patch: pytest.MonkeyPatch) -> Shown:
    del patch
    infos: Any = [Info("1", "lab-pc", 1.0), Info("2", "lab-pc", 2.0)]
    listing = StreamList()
    for now in (NOW_S, NOW_S + 1, NOW_S + 9):
        listing.update(infos, now)
    first, second = listing.streams.values()
    assert not first.note
    return Shown(1, second.note)


@provokes(Refusal.BY_ARRIVAL)
def by_arrival(patch: pytest.MonkeyPatch) -> Shown:
    del patch
    placer = Placer()
    placer.correction = 0.0
    placer.place(np.array([1.79e9]), NOW_S)
    stream = fake(receiver=fake(correction=0.0), received=fake(placer=placer))
    return Shown(1, _clock_note(stream))
