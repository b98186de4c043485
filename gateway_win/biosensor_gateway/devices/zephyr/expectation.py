"""What the shipped recording can fill, and when: derived from its bytes alone."""

from __future__ import annotations

from collections.abc import Iterator
from importlib.resources import files
from math import ceil
from typing import NamedTuple

from biosensor_common.sensors.zephyr import SENSOR
from biosensor_common.spec import StreamSpec
from biosensor_gateway.devices.zephyr.driver.frames import MessageId
from biosensor_gateway.devices.zephyr.driver.messages import (
    Acceleration,
    Message,
    RrIntervals,
    Summary,
    Waveform,
)
from biosensor_gateway.devices.zephyr.driver.protocol import ZephyrProtocol

RECORDING = "zephyr_bh3_2012-09-26_150s"

# Which number of the summary a stream shows; None there means "no value".
_NUMBERS = {
    "hr": "heart_rate_bpm",
    "hrv": "hrv_ms",
    "br": "respiration_rate_bpm",
    "posture": "posture_deg",
    "activity": "activity_vmu_g",
    "st": "skin_temperature_c",
    "bat": "battery_percent",
    "rssi": "rssi_db",
}


class Expectation(NamedTuple):
    """When a topic can have received data.

    Attributes
    ----------
    after_s
        Seconds of playback, None if the recording never fills it.
    reason
        Why not earlier, or never.
    """

    after_s: float | None
    reason: str


def expect(chunk_length: int) -> dict[str, Expectation]:
    """Return what to expect of each topic of the sensor while the recording is played."""
    first = _first_values()
    expected: dict[str, Expectation] = {}
    for stream in SENSOR.streams:
        after_s = first.get(stream.data_name)
        expected[stream.data_name] = _of_values(after_s)
        if stream.chunk:
            expected[f"{stream.chunk}_chunk"] = _of_chunks(stream, after_s, chunk_length)
    return expected


def _of_values(after_s: float | None) -> Expectation:
    if after_s is None:
        return Expectation(None, "the recorded device never reports a valid value")
    return Expectation(after_s, f"the recording's first valid value comes at {ceil(after_s)} s")


def _of_chunks(stream: StreamSpec, after_s: float | None, length: int) -> Expectation:
    if after_s is None or not isinstance(stream.rate, float | int):
        return _of_values(after_s)
    fill_s = length / stream.rate
    return Expectation(after_s + fill_s, f"a chunk of {length} samples takes {fill_s:.1f} s")


def _first_values() -> dict[str, float]:
    """Seconds of playback to the first value of each stream that has any."""
    first: dict[str, float] = {}
    last_rr: int | None = None
    for seconds, message in _messages():
        names = _filled_by(message)
        if isinstance(message, RrIntervals):
            readings = message.samples if last_rr is None else (last_rr, *message.samples)
            # A beat is a change of the reading, so the first reading is none.
            names = ["ibi"] if len(set(readings)) > 1 else []
            last_rr = message.samples[-1]
        for name in names:
            first.setdefault(name, seconds)
    return first


def _filled_by(message: Message) -> list[str]:
    match message:
        case Waveform():
            return ["ecg" if message.message_id is MessageId.ECG else "breathing"]
        case Acceleration():
            return ["acc"]
        case Summary():
            valid = [name for name, key in _NUMBERS.items() if message.numbers[key] is not None]
            return ["quality", *valid]
        case _:
            return []


def _messages() -> Iterator[tuple[float, Message]]:
    """Decode the recording; seconds since its first read."""
    folder = files("biosensor_gateway") / "devices" / "zephyr" / "simulator" / "recordings"
    data = (folder / f"{RECORDING}.dat").read_bytes()
    rows = (folder / f"{RECORDING}-timing.csv").read_text("ascii").split()
    reads = [(float(time), int(total)) for time, total in (row.split(",") for row in rows)]
    protocol, position = ZephyrProtocol(), 0
    for time, total in reads:
        for message in protocol.feed(data[position:total]):
            yield time - reads[0][0], message
        position = total
