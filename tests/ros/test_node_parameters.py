"""What each parameter of the running node silences, and which ones it refuses."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import pylsl
import pytest
from std_msgs.msg import Float32, Float32MultiArray

from biosensor_common.spec import DeviceIdentity, DeviceInfo
from biosensor_gateway.devices.registry import declaration
from biosensor_gateway.streaming.outlets import Outlet

if TYPE_CHECKING:
    from tests.ros.conftest import Ros, Status

pytestmark = [pytest.mark.nightly, pytest.mark.usefixtures("node")]

LENGTH = 4
BOOL, INTEGER, DOUBLE, STRING, STRINGS = 1, 2, 3, 4, 9
# Type, whether it is read at the start only, and a word of its description.
MEANINGS = {
    "Sensor_Enable": (BOOL, False, "publish any topics"),
    "Chunk_Enable": (BOOL, False, "publish chunk topics"),
    "Chunk_Length": (INTEGER, False, "samples in one chunk"),
    "topic_prefix": (STRING, False, "first part of every topic"),
    "stream_predicate": (STRING, False, "LSL query"),
    "burst_pacing": (DOUBLE, False, "per millisecond"),
    "session_id": (STRING, True, "LSL session"),
    "known_peers": (STRINGS, True, "hosts"),
}


class Belt:
    """A virtual device with a raw, a chunk and a hardware topic."""

    def __init__(self, ros: Ros, who: str, label: str = "") -> None:
        self._ros = ros
        identity = DeviceIdentity("polar_h10", "U1", participant=who, label=label)
        ecg, acc = (declaration("polar_h10").stream(data) for data in ("ecg", "acc"))
        self._ecg = Outlet(ecg, identity, DeviceInfo())
        self._acc = Outlet(acc, identity, DeviceInfo())
        self._base = f"/{who}/biosensors/polar_h10" + (f"_{label}" if label else "")
        self._stamp = pylsl.local_clock() - 10.0
        self._pushed = 0
        self._expected = Counter[str]()
        self._heard = {
            name: ros.listen(kind, f"{self._base}/{name}")
            for name, kind in (
                ("ecg", Float32),
                ("ecg_chunk", Float32MultiArray),
                ("acc", Float32MultiArray),
            )
        }

    def push(self, **messages: int) -> None:
        """Push a chunk's worth of samples, of which so many messages must come by topic."""
        for _ in range(LENGTH):
            self._stamp += 1 / 130
            self._pushed += 1
            assert self._ecg.push([float(self._pushed)], [self._stamp]) is None
            assert self._acc.push([[0.0, 0.0, 1.0]], [self._stamp]) is None
        self._expected.update(messages)

    def settle(self) -> None:
        """Wait for what must come; what comes too much is found at the next call."""
        self._ros.until(self._has_received_all, "all samples at the node")
        self._ros.until(lambda: self._counts() >= self._expected, f"{self._expected}")
        assert self._counts() == self._expected

    def _counts(self) -> Counter[str]:
        return Counter({name: len(messages) for name, messages in self._heard.items()})

    def is_attached(self) -> bool:
        """Whether the node has both streams, with the subscribers of their topics."""
        ecg, acc = self._statuses()
        return bool(ecg and acc and ecg["subscribers"] == "2" and acc["subscribers"] == "1")

    def _has_received_all(self) -> bool:
        return all(
            status and status["received"] == str(self._pushed) for status in self._statuses()
        )

    def _statuses(self) -> list[Status | None]:
        return [self._ros.status(f"{self._base}/{data}") for data in ("ecg", "acc")]


@pytest.fixture(autouse=True)
def defaults(ros: Ros) -> Iterator[None]:
    assert ros.set("Chunk_Length", LENGTH) == ""
    yield
    assert ros.set("Sensor_Enable", value=True) == ""
    assert ros.set("Chunk_Enable", value=True) == ""


@pytest.mark.seam
def test_sensor_enable_silences_everything_and_chunk_enable_the_chunks(ros: Ros) -> None:
    belt = Belt(ros, "everything")
    ros.until(belt.is_attached, "the belt")
    belt.push(ecg=LENGTH, ecg_chunk=1, acc=LENGTH)
    belt.settle()
    assert ros.set("Chunk_Enable", value=False) == ""
    belt.push(ecg=LENGTH, acc=LENGTH)
    belt.settle()
    assert ros.set("Sensor_Enable", value=False) == ""
    belt.push()
    belt.settle()
    assert ros.set("Chunk_Enable", value=True) == ""
    belt.push()
    belt.settle()
    assert ros.set("Sensor_Enable", value=True) == ""
    belt.push(ecg=LENGTH, ecg_chunk=1, acc=LENGTH)
    belt.settle()
    ros.report()
    belt.settle()


@pytest.mark.seam
def test_the_most_specific_key_wins_also_if_it_was_set_before_the_stream_came(ros: Ros) -> None:
    assert ros.set("Sensor_Enable", value=False) == ""
    assert ros.set("specific.polar_h10_left.Sensor_Enable", value=True) == ""
    assert ros.set("specific.polar_h10_left.acc.Sensor_Enable", value=False) == ""
    left, right = belts = Belt(ros, "specific", "left"), Belt(ros, "specific", "right")
    ros.until(lambda: all(belt.is_attached() for belt in belts), "both belts")
    left.push(ecg=LENGTH, ecg_chunk=1)
    right.push()
    left.settle()
    right.settle()
    # A data name of the sensor is more specific than a label without a data name.
    assert ros.set("specific.polar_h10.ecg.Sensor_Enable", value=True) == ""
    assert ros.set("specific.polar_h10.ecg.Chunk_Enable", value=False) == ""
    left.push(ecg=LENGTH)
    right.push(ecg=LENGTH)
    for _ in range(2):
        left.settle()
        right.settle()
        ros.report()


def test_the_chunk_of_the_breathing_waveform_belongs_to_the_rate(ros: Ros) -> None:
    identity = DeviceIdentity("zephyr", "U1", participant="breath")
    stream = declaration("zephyr").stream("breathing")
    outlet = Outlet(stream, identity, DeviceInfo())
    base = "/breath/biosensors/zephyr"
    raw = ros.listen(Float32, f"{base}/breathing")
    chunks = ros.listen(Float32MultiArray, f"{base}/br_chunk")
    assert ros.set("breath.zephyr.br.Chunk_Length", 3) == ""
    assert ros.set("breath.zephyr.breathing.Chunk_Length", 2) == ""
    ros.attached(f"{base}/breathing", readers=2)
    start = pylsl.local_clock() - 5.0
    stamps = [start + number * 0.056 for number in range(6)]
    assert outlet.push(range(6), stamps) is None
    ros.until(lambda: len(raw) == 6 and len(chunks) == 2, "six samples, two chunks")
    assert [list(chunk.data) for chunk in chunks] == [[0, 1, 2], [3, 4, 5]]
    assert ros.set("breath.zephyr.br.Sensor_Enable", value=False) == ""
    assert outlet.push(range(6), [stamp + 6 * 0.056 for stamp in stamps]) is None
    ros.until(lambda: len(raw) == 12, "six more samples")
    ros.report()
    assert len(chunks) == 2
    assert f"{base}/breathing_chunk" not in ros.topics()


@pytest.mark.parametrize(
    ("name", "value", "reason"),
    [
        ("Chunk_Length", 0, "Chunk_Length out of range"),
        ("Chunk_Length", 100_001, "Chunk_Length out of range"),
        ("Chunk_Length", 12.5, "type"),
        ("Chunk_Enable", 1, "type"),
        ("polar_h10.Sensor_Enable", "true", "polar_h10.Sensor_Enable must be true or false"),
        ("polar_h10.ecg.Chunk_Length", -1, "polar_h10.ecg.Chunk_Length must be"),
        ("polar_h10.ecg.Chunk_Lenght", 12, "polar_h10.ecg.Chunk_Lenght is not a parameter"),
        ("Sensor_Enabled", True, "Sensor_Enabled is not a parameter"),
        ("processes", 4, "processes is no longer a parameter: the node runs in one process"),
        ("session_id", "elsewhere", "read-only parameter: session_id"),
        ("known_peers", "10.0.0.1", "read-only parameter: known_peers"),
        ("qos_overrides./a/b.publisher.depth", 0, "qos_overrides./a/b.publisher.depth must be"),
        ("qos_overrides./a/b.publisher.reliability", "some", "reliability must be one of reliable"),
        ("qos_overrides./a/b.publisher.lifespan", 1, "publisher.lifespan: only depth, history"),
    ],
)
def test_a_refusal_comes_back_with_its_reason(ros: Ros, name: str, value: Any, reason: str) -> None:
    assert reason in ros.set(name, value)


def test_what_every_parameter_means_can_be_asked(ros: Ros) -> None:
    described = ros.describe(*MEANINGS)
    for name, (kind, read_only, word) in MEANINGS.items():
        descriptor = described[name]
        assert (descriptor.name, descriptor.type) == (name, kind)
        assert descriptor.read_only is read_only
        assert not descriptor.dynamic_typing
        assert word in descriptor.description
    (limits,) = described["Chunk_Length"].integer_range
    assert (limits.from_value, limits.to_value, limits.step) == (1, 100_000, 1)
    (limits,) = described["burst_pacing"].floating_point_range
    assert (limits.from_value, limits.to_value, limits.step) == (0.0, 1000.0, 0.0)


def test_a_key_of_a_sensor_can_be_set_before_and_is_described_once_it_is_there(ros: Ros) -> None:
    assert ros.set("absent.EEG.Chunk_Length", 2) == ""
    assert "absent.EEG.Chunk_Length must be" in ros.set("absent.EEG.Chunk_Length", 0)
    # Taken back, as if it had never been set.
    assert ros.set("absent.Chunk_Enable", value=False) == ""
    assert ros.set("absent.Chunk_Enable", None) == ""
    info = pylsl.StreamInfo("absent", "EEG", 1, 100.0, "float32", "absent")
    outlet = pylsl.StreamOutlet(info)
    topic = "/biosensors/absent/EEG"
    chunks = ros.listen(Float32MultiArray, f"{topic}_chunk")
    ros.attached(topic, readers=1)
    begun = pylsl.local_clock()
    outlet.push_chunk([[1.0], [2.0]], [begun, begun + 0.01])
    ros.until(lambda: bool(chunks), "a chunk of two")
    assert list(chunks[0].data) == [1.0, 2.0]
    for owner, keys in (
        ("absent", ("Sensor_Enable", "Chunk_Enable", "Chunk_Length")),
        ("absent.EEG", ("Sensor_Enable", "Chunk_Enable", "Chunk_Length")),
    ):
        for name, descriptor in ros.describe(*(f"{owner}.{key}" for key in keys)).items():
            general = ros.describe(name.rpartition(".")[2]).popitem()[1].description
            assert descriptor.description.startswith(general), name
            assert "not set" in descriptor.description
