"""From the device to ROS, for every sensor: each sample once, in order, on time.

The virtual devices run in a process of their own, with drifting oscillators and a radio
that delays every packet by up to `JITTER_S`; Bluetooth ones are reached through bleak's
stock Linux backend. What a subscriber gets is compared with what the devices sent,
and the stamps in LSL with the true times of measuring.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Generator, Iterable
from itertools import cycle
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pylsl
import pytest
from numpy.typing import NDArray

from biosensor_common.lsl_header import read_header
from biosensor_common.naming import source_id
from biosensor_common.quantities import ContentType
from biosensor_common.spec import DeviceIdentity, StreamSpec
from biosensor_gateway.devices.registry import declaration
from biosensor_gateway.features.sources import Source, judge
from biosensor_gateway.simulation.wearer import Wearer
from lsl_to_ros.topics.outputs import CLASSES
from tests.faults.expectations import (
    SENSORS,
    device_of,
    is_by_agent,
    numeric_streams,
    regular_streams,
)
from tests.rigs.lab_client import LabProcess, Samples, settings_toml
from tests.rigs.polling import wait_until
from tests.rigs.turns import turns

JITTER_S = 0.03
SECONDS = 30.0
SETTLED_S = 10.0
# The wristband's heart rate comes six seconds after the beat.
LATEST_S = 6.5
# What has come by LSL has come by ROS, too.
AT_NODE_S = 1.0
STAMP_LIMIT_S = 0.020
READ_LATE_S = 0.25
# Before it is known which way up a pulse is.
UNSETTLED_BEATS = 4
SPACING_LIMIT_S = 0.001
_DRIFTS_PPM = (-80.0, 120.0, -150.0, 150.0, 60.0, 100.0, -100.0)
_DRIFT_PPM = dict(zip(SENSORS, cycle(_DRIFTS_PPM), strict=False))
_MARKS = {name: DeviceIdentity(name, name.upper()) for name in SENSORS}

Floats = NDArray[np.float64]


class Recorded(NamedTuple):
    times: Floats
    values: Floats


class Recorder:
    """Pulls streams by source_id in a thread."""

    def __init__(self, source_ids: list[str]) -> None:
        self._wanted = set(source_ids)
        self._inlets: dict[str, pylsl.StreamInlet] = {}
        self._chunks: dict[str, list[tuple[list[float], list[list[float]]]]] = {
            source: [] for source in source_ids
        }
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        resolver = pylsl.ContinuousResolver()
        while not self._stopping.is_set():
            for info in resolver.results():
                source = info.source_id()
                if source in self._wanted and source not in self._inlets:
                    self._inlets[source] = pylsl.StreamInlet(info, recover=False)
            for source, inlet in self._inlets.items():
                samples, stamps = inlet.pull_chunk(timeout=0.0, max_samples=4096)
                if stamps:
                    self._chunks[source].append((list(stamps), [list(row) for row in samples]))
            time.sleep(0.02)

    def stop(self) -> None:
        self._stopping.set()
        self._thread.join()

    def newest(self, source: str) -> float:
        """LSL time of a stream's last sample."""
        chunks = self._chunks[source]
        return chunks[-1][0][-1] if chunks else 0.0

    def described(self, source: str) -> str:
        """What a stream says of itself."""
        return self._inlets[source].info().as_xml()

    def recorded(self, source: str) -> Recorded:
        times = [stamp for stamps, _ in self._chunks[source] for stamp in stamps]
        rows = [row for _, samples in self._chunks[source] for row in samples]
        return Recorded(np.array(times, np.float64), np.array(rows, np.float64))


@pytest.fixture(params=turns(SENSORS), ids="+".join)
def sensors(request: pytest.FixtureRequest) -> tuple[str, ...]:
    """Those whose turn it is."""
    return request.param


@pytest.fixture
def lab(sensors: tuple[str, ...], tmp_path: Path) -> Generator[LabProcess]:
    devices = [
        {
            "key": name,
            "sensor": name,
            "options": {
                "seed": SENSORS.index(name) + 1,
                "jitter_s": JITTER_S,
                "drift_ppm": _DRIFT_PPM[name],
            },
        }
        for name in sensors
    ]
    with LabProcess(devices, tmp_path) as running:
        yield running


def _listed(name: str, data_names: Iterable[str]) -> list[StreamSpec]:
    return [declaration(name).stream(each) for each in data_names]


def _places(part: Floats, whole: Floats, what: str) -> list[int]:
    """Where *part* may begin in *whole*; floats are compared as ROS carries them."""
    part32, whole32 = part.astype(np.float32), whole.astype(np.float32)
    places = [
        start
        for start in range(len(whole32) - len(part32) + 1)
        if _same(whole32[start], part32[0]) and _same(whole32[start : start + len(part32)], part32)
    ]
    assert places, f"{what}: what arrived is not a part of what was sent"
    return places


def _same(a: NDArray[np.float32], b: NDArray[np.float32]) -> bool:
    return np.allclose(a, b, rtol=2e-6, atol=1e-6, equal_nan=True)


def _check_values(received: Floats, truth: Samples, until_s: float, what: str) -> None:
    """Received is the truth up to a time at least, without a hole, a repetition or a swap."""
    assert len(received), f"{what}: nothing arrived"
    end = _places(received, truth.values, what)[-1] + len(received)
    missing = int((truth.times[end:] < until_s).sum())
    assert not missing, f"{what}: the last {missing} samples are missing"


def _check_stamps(name: str, stream: StreamSpec, lsl: Recorded, truth: Samples) -> str:
    what = f"{name}/{stream.data_name}"
    # Values that repeat themselves fit in several places; the stamps tell which it is.
    places = _places(lsl.values, truth.values, what)
    differences = (lsl.times - truth.times[start : start + len(lsl.times)] for start in places)
    errors = min(differences, key=lambda each: float(np.abs(each).max()))
    settled = lsl.times > truth.times[0] + SETTLED_S
    if not settled.any():
        return f"{what}: too few samples"
    off = np.abs(errors[settled])
    worst, typical = float(off.max()), float(np.median(off))
    uncertain_s = device_of(name).expected.unstamped_s.get(stream.data_name)
    if uncertain_s is not None:
        # It is stamped when it is read, by a host that may be busy now and then.
        limit = STAMP_LIMIT_S + JITTER_S + uncertain_s
        assert typical <= limit, f"{what}: stamps are {1000 * typical:.1f} ms off"
        assert worst <= limit + READ_LATE_S, f"{what}: a stamp is {1000 * worst:.1f} ms off"
    else:
        assert worst <= STAMP_LIMIT_S, f"{what}: a stamp is {1000 * worst:.1f} ms off"
    if stream.rate == 0:
        return f"{what}: worst {1000 * worst:.2f} ms"
    spacing = np.diff(errors[settled])
    rms = float(np.sqrt(np.mean(spacing**2)))
    assert rms < SPACING_LIMIT_S, f"{what}: spacing RMS {1000 * rms:.2f} ms"
    return f"{what}: worst {1000 * worst:.2f} ms, spacing RMS {1000 * rms:.3f} ms"


def _check_beats(source: Source, lsl: Recorded) -> str:
    """A pulse or an ECG has the beats of who wears it, no more and no fewer."""
    events = source.new_computer().take(lsl.times, lsl.values)
    beats = np.array([each.values for each in events if each.feature == "beats"][UNSETTLED_BEATS:])
    found = f"{source.name}: {60 / np.median(beats[:, 0]):.1f} beats a minute, {len(beats)} beats"
    assert 60 / np.median(beats[:, 0]) == pytest.approx(Wearer(1).heart_rate_bpm, rel=0.1), found
    assert np.mean(beats[:, 1]) < 0.1, f"{source.name}: {np.sum(beats[:, 1])} artefacts, {found}"
    return found


def _flat(messages: list[Any]) -> Floats:
    return np.array([np.atleast_1d(message.data) for message in messages], np.float64)


# Seven devices, agent, node, recorder and subscriber take 1.6 processors, and the stamps of what a
# device does not stamp itself are as late as its reader: so nothing beside, and sensors in turns.
@pytest.mark.nightly
@pytest.mark.alone
def test_every_sensor_from_device_to_ros(
    sensors: tuple[str, ...],
    lab: LabProcess,
    programs: Any,
    listener: Any,
    monkeypatch: pytest.MonkeyPatch,
    record_property: Callable[[str, object], None],
) -> None:
    for key, value in lab.environment.items():
        monkeypatch.setenv(key, value)
    streams = {name: _listed(name, numeric_streams(name)) for name in sensors}
    topics = {
        (name, stream.data_name): listener.listen(
            CLASSES[stream.message_type], f"/biosensors/{name}/{stream.data_name}"
        )
        for name in sensors
        for stream in streams[name]
    }
    sources = {key: source_id(_MARKS[key[0]], key[1]) for key in topics}
    recorder = Recorder(list(sources.values()))
    programs.node()
    programs.agent(settings_toml(lab, {name: name for name in sensors}))
    regular = [(name, data_name) for name in sensors for data_name in regular_streams(name)]
    wait_until(lambda: all(topics[key] for key in regular), "all regular streams", 60.0)
    time.sleep(SECONDS)
    until_s = pylsl.local_clock()
    # A busy machine has a backlog.
    newest = [sources[key] for key in regular]
    wait_until(
        lambda: all(recorder.newest(source) > until_s + LATEST_S for source in newest),
        "all that was measured by then",
        60.0,
    )
    time.sleep(AT_NODE_S)
    received = {key: list(messages) for key, messages in topics.items()}
    recorder.stop()
    status = programs.status()
    truths = {name: lab.truth(name) for name in sensors}

    for device in status["devices"]:
        assert device["connections"] == 1, device
        for source, counters in device["streams"].items():
            assert (counters["lost"], counters["refused"]) == (0, 0), source
    for name in sensors:
        for stream in streams[name]:
            key = (name, stream.data_name)
            if is_by_agent(*key) or stream.data_name not in truths[name]:
                continue
            truth = truths[name][stream.data_name]
            _check_values(_flat(received[key]), truth, until_s, "/".join(key))
            report = _check_stamps(name, stream, recorder.recorded(sources[key]), truth)
            record_property("/".join(key), report)
            print(report)
            if stream.is_regular and stream.content_type in (ContentType.ECG, ContentType.PPG):
                header = read_header(recorder.described(sources[key]))
                source = judge("/".join(key), sources[key], header)
                assert source is not None
                print(_check_beats(source, recorder.recorded(sources[key])))
