"""What the demo can fill in so many seconds, and why not the rest."""

from __future__ import annotations

from biosensor_common.registry import sensor
from biosensor_common.spec import StreamSpec
from biosensor_gateway.devices.zephyr.expectation import Expectation
from biosensor_gateway.devices.zephyr.expectation import expect as expect_of_recording

SENSORS = {
    "empatica_e4": "empatica_e4",
    "emotiv_insight": "emotiv_insight",
    "shimmer3_gsr": "shimmer3_gsr",
    "polar_h10": "polar_h10",
    "vernier_respiration_belt": "vernier_respiration_belt",
    "zephyr": "zephyr:recording",
    "ble_heart_rate": "ble_heart_rate",
}
"""The virtual device of each sensor."""

# From the first sample of any device until every other one is found and connected.
CONNECT_S = 9.0
# Rates of devices that say them when they are connected.
_RATES_HZ = {"vernier_respiration_belt": 10.0}

_EXCEPTIONS = {
    ("empatica_e4", "hr"): Expectation(8, "the server sends it six seconds late"),
    ("empatica_e4", "ibi"): Expectation(8, "the server sends it six seconds late"),
    ("empatica_e4", "bat"): Expectation(11, "the server sends it every ten seconds"),
    ("empatica_e4", "tag"): Expectation(None, "nobody presses the virtual wristband's button"),
    ("empatica_e4", "gsr"): Expectation(2, "the server sends it in bursts"),
    ("empatica_e4", "st"): Expectation(2, "the server sends it in bursts"),
    ("emotiv_insight", "gyro"): Expectation(None, "only headsets with older firmware have it"),
    ("shimmer3_gsr", "hr"): Expectation(7, "it takes five heart beats"),
}


def expected_topics(seconds: float | None, chunk_length: int) -> dict[str, str]:
    """Return by topic: empty text, or why it will have received nothing.

    Parameters
    ----------
    seconds
        Counted from the first sample of any device; None has no end.
    chunk_length
        Samples in a chunk.
    """
    limit = float("inf") if seconds is None else seconds - CONNECT_S
    expected: dict[str, str] = {}
    for name in SENSORS:
        for topic, expectation in _of_sensor(name, chunk_length).items():
            expected[f"/biosensors/{name}/{topic}"] = _reason(expectation, limit)
    return expected


def _of_sensor(name: str, chunk_length: int) -> dict[str, Expectation]:
    if name == "zephyr":
        return expect_of_recording(chunk_length)
    expected: dict[str, Expectation] = {}
    for stream in sensor(name).streams:
        value = _EXCEPTIONS.get((name, stream.data_name), Expectation(0, ""))
        expected[stream.data_name] = value
        if stream.chunk:
            expected[f"{stream.chunk}_chunk"] = _of_chunks(name, stream, value, chunk_length)
    return expected


def _of_chunks(name: str, stream: StreamSpec, value: Expectation, chunk_length: int) -> Expectation:
    rate = stream.rate if isinstance(stream.rate, float | int) else _RATES_HZ[name]
    fill_s = chunk_length / rate
    reason = f"a chunk of {chunk_length} samples takes {fill_s:.1f} s"
    return Expectation((value.after_s or 0) + fill_s, reason)


def _reason(expectation: Expectation, limit_s: float) -> str:
    if expectation.after_s is None:
        return expectation.reason
    return "" if expectation.after_s <= limit_s else expectation.reason
