"""Layouts that only optical sensors send, against vectors; others are tested for the strap."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from biosensor_common.spec import DeviceInfo
from biosensor_gateway.devices.polar_h10.driver.protocol.control_point import (
    Measurement,
    Reply,
    Setting,
    choose,
    parse_indication,
    parse_settings,
    start,
)
from biosensor_gateway.devices.polar_h10.driver.protocol.frames import (
    PulseIntervals,
    Rejected,
    parse_frame,
)
from biosensor_gateway.devices.polar_verity_sense.driver import true_ppg_rates

VECTORS: list[dict[str, Any]] = json.loads(
    (Path(__file__).parent / "vectors" / "polar_optical.json").read_text(encoding="utf-8")
)
DATA = [vector for vector in VECTORS if vector["kind"] == "data"]
REPLIES = {vector["name"]: vector for vector in VECTORS if vector["kind"] == "control_point"}


def samples(data: bytes, factors: dict[int, float]) -> np.ndarray[Any, np.dtype[np.float64]]:
    frame = parse_frame(data, factors)
    assert not isinstance(frame, Rejected | PulseIntervals)
    return np.array(frame.samples, np.float64)


@pytest.mark.parametrize("vector", DATA, ids=lambda vector: vector["name"])
def test_frame(vector: dict[str, Any]) -> None:
    data, expected = bytes.fromhex(vector["hex"]), vector["expected"]
    frame = parse_frame(data, {expected["type"]: vector["factor"]})
    assert not isinstance(frame, Rejected)
    header = frame.header
    assert (header.measurement, header.timestamp_ns, header.frame_type) == (
        expected["type"],
        expected["timestamp_ns"],
        expected["layout"],
    )
    found = samples(data, {expected["type"]: vector["factor"]})
    np.testing.assert_allclose(found, np.array(expected["samples"], np.float64), rtol=1e-12)


@pytest.mark.parametrize("vector", DATA, ids=lambda vector: vector["name"])
def test_a_frame_that_is_cut_is_dropped_or_ends_with_a_block(vector: dict[str, Any]) -> None:
    data, kind = bytes.fromhex(vector["hex"]), vector["expected"]["type"]
    whole = samples(data, {kind: vector["factor"]})
    kept = 0
    for length in range(len(data)):
        cut = parse_frame(data[:length], {kind: vector["factor"]})
        if not isinstance(cut, Rejected | PulseIntervals):
            kept += 1
            np.testing.assert_array_equal(np.array(cut.samples), whole[: len(cut.samples)])
    # Where a block ends, there alone.
    assert kept < len(whole)


@pytest.mark.parametrize("name", [name for name in REPLIES if "settings" in name])
def test_settings(name: str) -> None:
    reply = parse_indication(bytes.fromhex(REPLIES[name]["hex"]))
    assert isinstance(reply, Reply)
    found = {
        key.name.lower(): list(values) for key, values in parse_settings(reply.parameters).items()
    }
    assert found == REPLIES[name]["expected"]


def test_the_factor_of_a_reply_scales_the_frames() -> None:
    reply = parse_indication(bytes.fromhex(REPLIES["start_gyro_ok_with_factor"]["hex"]))
    assert isinstance(reply, Reply)
    assert parse_settings(reply.parameters)[Setting.FACTOR] == pytest.approx((0.07,))


def test_a_start_names_the_channels_in_one_byte() -> None:
    reply = parse_indication(bytes.fromhex(REPLIES["settings_ppg_says_135_has_55"]["hex"]))
    assert isinstance(reply, Reply)
    chosen = choose(parse_settings(reply.parameters), {Setting.SAMPLE_RATE: 55})
    assert start(Measurement.PPG, chosen).hex() == "0201" + "00018700" + "01011600" + "040104"


@pytest.mark.parametrize(
    ("model", "firmware", "sdk_mode", "rates"),
    [
        ("Verity Sense", "1.1.4", False, {}),
        ("Verity Sense", "1.1.5", False, {135: 55}),
        ("Verity Sense", "2.0.9", False, {135: 55}),
        ("Verity Sense", "2.1.0", False, {}),
        ("Verity Sense", "1.1.5", True, {}),
        ("OH1", "2.1.17", False, {130: 135}),
        ("OH1+", "", False, {130: 135}),
        ("360", "2.0.8", False, {}),
        ("Verity Sense", "", False, {}),
        ("", "", False, {}),
    ],
)
def test_true_rates(model: str, firmware: str, *, sdk_mode: bool, rates: dict[int, int]) -> None:
    info = DeviceInfo(model=model, firmware_version=firmware)
    assert true_ppg_rates(info, sdk_mode=sdk_mode) == rates
