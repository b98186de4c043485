"""Every vector of the family: bytes in, meaning out."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from biosensor_gateway.devices.shimmer.driver import exg, typical_calibrations
from biosensor_gateway.devices.shimmer.driver.calibration import Block, stored
from biosensor_gateway.devices.shimmer.driver.channels import Layout
from biosensor_gateway.devices.shimmer.driver.conversation import Kind
from biosensor_gateway.devices.shimmer.driver.exg import Exg, Use, microvolts, registers_for
from biosensor_gateway.devices.shimmer.driver.messages import (
    Firmware,
    Inquiry,
    Packet,
    PressureChip,
    PressureCoefficients,
)
from biosensor_gateway.devices.shimmer.driver.protocol import ShimmerProtocol
from biosensor_gateway.devices.shimmer.driver.signals import are_real, compensation, motion_signals

Vector = dict[str, Any]
VECTORS: list[Vector] = json.loads(
    (Path(__file__).parent / "vectors" / "shimmer.json").read_text(encoding="utf-8")
)["vectors"]
PASCALS = 0.5


def of_kind(kind: str) -> pytest.MarkDecorator:
    chosen = [vector for vector in VECTORS if vector["kind"] == kind]
    assert chosen
    return pytest.mark.parametrize("vector", chosen, ids=lambda vector: vector["name"])


def test_no_kind_of_vector_is_left_out() -> None:
    kinds = {"block", "stream", "air", "registers", "exg"}
    assert {vector["kind"] for vector in VECTORS} == kinds


@of_kind("block")
def test_blocks_of_the_memory(vector: Vector) -> None:
    block = Block[vector["block"]]
    memory = b"\xff" * 21 * block + bytes.fromhex(vector["hex"])
    found, expected = stored(memory, block), vector["expected"]
    if expected is None:
        assert found is None
    else:
        assert found is not None
        np.testing.assert_allclose(found.apply([expected["raw"]]), [expected["calibrated"]])


@of_kind("stream")
def test_typical_values_where_a_memory_has_none(vector: Vector) -> None:
    kind = Kind(vector["hw"], Firmware(3, (1, 1, 2)))
    layout = kind.layout(vector["channels"])
    protocol = ShimmerProtocol()
    protocol.expect_data(layout, vector["divisor"])
    found = [*protocol.feed(bytes.fromhex(vector["hex"]), 0.0), *protocol.settle()]
    values = [message.values for message, _ in found if isinstance(message, Packet)]
    assert len(values) == 2
    setup = bytes.fromhex(vector["setup"])
    present = Inquiry(vector["divisor"], setup, tuple(vector["channels"]))
    (signal,) = motion_signals(layout, typical_calibrations(kind, layout, present, None))
    (name,) = vector["expected"]
    assert signal.data_name == name
    raw = np.array(values, np.float64)[:, signal.at]
    np.testing.assert_allclose(signal.convert(raw), [vector["expected"][name]] * 2, atol=1e-9)


@of_kind("air")
def test_pressure_and_temperature(vector: Vector) -> None:
    coefficients = PressureCoefficients(vector["chip"], bytes.fromhex(vector["hex"]))
    compensate = compensation(coefficients, vector["oversampling"])
    assert compensate is not None
    raw = np.array([vector["raw_t"]], np.float64), np.array([vector["raw_p"]], np.float64)
    (pascals,), (celsius,) = compensate(*raw)
    # The example of the oldest chip is in whole numbers, of which one is 3 Pa or 0.1 degrees.
    assert pascals == pytest.approx(vector["expected"]["pa"], abs=vector["within_pa"])
    assert celsius == pytest.approx(vector["expected"]["celsius"], abs=vector["within_celsius"])


@of_kind("registers")
def test_registers_of_the_exg_chips(vector: Vector) -> None:
    expected, chip = vector["expected"], int(vector["chip"])
    use, lead_off = Use(expected["use"]), expected["lead_off"]
    wanted = registers_for(use, expected["gain"], vector["rate_hz"], lead_off=lead_off)
    assert exg.are_same(bytes.fromhex(vector["hex"]), wanted[chip])
    assert not exg.are_same(bytes.fromhex(vector["hex"]), wanted[1 - chip])
    set_up = Exg(wanted)
    assert set_up.use is use
    assert set_up.detects_lead_off is lead_off
    assert {set_up.gain(0, 1), set_up.gain(0, 2)} == {expected["gain"]}


@of_kind("exg")
def test_voltages(vector: Vector) -> None:
    raw = int.from_bytes(bytes.fromhex(vector["hex"]), "big", signed=True)
    (value,) = microvolts([raw], vector["gain"], vector["bits"]).tolist()
    assert value == pytest.approx(vector["expected"]["uv"], rel=1e-12)


# What a chip of the shop said; its formula in whole numbers is Bosch's other one.
BMP390 = (27738, 19081, -10, 1127, -743, 35, 0, 25286, 30515, 3, -10, 16334, 24, -60)


def in_whole_numbers(numbers: Sequence[int], raw_t: int, raw_p: int) -> tuple[float, float]:
    """Compensate as Bosch's formula for 64-bit integers does."""
    t1, t2, t3, p1, p2, p3, p4, p5, p6, p7, p8, p9, p10, p11 = numbers
    d = raw_t - 256 * t1
    t = (t2 * d * 262144 + d * d * t3) // 4294967296
    square = t * t
    cube = square // 64 * t // 256
    offset = p8 * cube // 32 + p7 * square * 16 + p6 * t * 4194304 + p5 * 140737488355328
    slope = p4 * cube // 32 + p3 * square * 4
    slope += (p2 - 16384) * t * 2097152 + (p1 - 16384) * 70368744177664
    bent = raw_p * ((p10 * t + 65536 * p9) * raw_p // 8192 // 10) // 512 * 10
    whole = offset // 4 + slope // 16777216 * raw_p + bent
    whole += p11 * raw_p * raw_p // 65536 * raw_p // 128
    return whole * 25 // 1099511627776 / 100, t * 25 // 16384 / 100


@pytest.mark.parametrize("raw_p", [5_000_000, 6_500_000, 8_000_000])
@pytest.mark.parametrize("raw_t", [7_900_000, 8_300_000, 8_800_000])
def test_a_bmp390_by_both_formulas_of_its_maker(raw_t: int, raw_p: int) -> None:
    data = memory_of(BMP390)
    compensate = compensation(PressureCoefficients(PressureChip.BMP390, data), 0)
    assert compensate is not None
    (pascals,), (celsius,) = compensate(np.array([raw_t], float), np.array([raw_p], float))
    expected_pa, expected_c = in_whole_numbers(BMP390, raw_t, raw_p)
    assert pascals == pytest.approx(expected_pa, abs=PASCALS)
    assert celsius == pytest.approx(expected_c, abs=0.02)


def memory_of(numbers: Sequence[int]) -> bytes:
    widths = (2, 2, 1, 2, 2, 1, 1, 2, 2, 1, 1, 2, 1, 1)
    parts = zip(numbers, widths, strict=True)
    return b"".join((each % (1 << 8 * width)).to_bytes(width, "little") for each, width in parts)


@pytest.mark.parametrize("filling", [b"\x01", b"\x00", b"\xff"])
def test_coefficients_of_no_chip_are_none(filling: bytes) -> None:
    assert not are_real(PressureCoefficients(PressureChip.BMP180, filling * 22))


@pytest.mark.parametrize("chip", [-1, 4, PressureChip.BMP280])
def test_an_unknown_pressure_chip_has_no_compensation(chip: int) -> None:
    assert compensation(PressureCoefficients(chip, bytes(5)), 0) is None


def test_a_packet_of_all_sensors_is_as_long_as_its_channels() -> None:
    ids = [0, 1, 2, 10, 11, 12, 4, 5, 6, 7, 8, 9, 26, 27, 29, 30, 31, 32, 33, 34]
    assert Layout(ids).size == 4 * 6 + 5 + 14
    assert Layout(ids, is_3r=True).size == 4 * 6 + 6 + 14
