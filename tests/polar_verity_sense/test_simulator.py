"""The virtual optical sensors speak as published: byte by byte, and through plain bleak."""

from __future__ import annotations

from collections.abc import Callable
from math import inf

import pytest
from hypothesis import given
from hypothesis import strategies as st

from biosensor_gateway.devices.polar_h10.simulator.pmd import Measurement, Setting
from biosensor_gateway.devices.polar_h10.simulator.pmd_service import ControlPoint
from biosensor_gateway.devices.polar_h10.simulator.products import Product
from biosensor_gateway.devices.polar_h10.simulator.waveforms import waveform
from biosensor_gateway.devices.polar_verity_sense.simulator import (
    OH1,
    OLD_VERITY_SENSE,
    POLAR_360,
    VERITY_SENSE,
    SimulatedPolarVeritySense,
)
from biosensor_gateway.simulation.faults import Fault, FaultKind
from biosensor_gateway.simulation.radio import Radio
from biosensor_gateway.simulation.wearer import Wearer
from tests.rigs.bluetooth import ON_BUMBLE
from tests.rigs.gatt_host import connection
from tests.rigs.polar_h10 import CONTROL, frames_of, open_pmd
from tests.rigs.polling import until

START_ACC = "02 02 00 01 34 00 01 01 10 00 02 01 08 00 04 01 03"
START_PPG = "02 01 00 01 37 00 01 01 16 00 04 01 04"
FULL_MTU = 232
NAME = "Polar Sense 5E45E001"
MakeSensor = Callable[..., SimulatedPolarVeritySense]


def ask(point: ControlPoint, command: str, mtu: int = FULL_MTU) -> str:
    return " ".join(packet.hex() for packet in point.answer(bytes.fromhex(command), mtu))


def spaced(text: str) -> str:
    return text.replace(" ", "").lower()


@pytest.mark.parametrize(
    ("command", "reply"),
    [
        ("0102", "F0 01 02 00 00 00 01 34 00 01 01 10 00 02 01 08 00 04 01 03"),
        ("0105", "F0 01 05 00 00 00 01 34 00 01 01 10 00 02 01 D0 07 04 01 03"),
        (START_ACC, "F0 02 02 00 00 05 01 40 DA 7F 39"),
        (START_PPG, "F0 02 01 00 00"),
        ("0203", "F0 02 03 00 00"),
        ("0209", "F0 02 09 00 00"),
        ("06", "F0 06 00 00 00 00"),
    ],
)
def test_a_verity_sense_answers_as_published(command: str, reply: str) -> None:
    assert ask(ControlPoint(VERITY_SENSE), command) == spaced(reply)


@pytest.mark.parametrize(("product", "said"), [(OLD_VERITY_SENSE, 135), (OH1, 130)])
def test_firmware_may_say_a_rate_wrong(product: Product, said: int) -> None:
    reply = bytes.fromhex(ask(ControlPoint(product), "0101"))
    assert int.from_bytes(reply[7:9], "little") == said


def test_channels_have_a_status_of_their_own() -> None:
    assert ask(ControlPoint(VERITY_SENSE), START_ACC[:-2] + "04") == "f002020b00"


def test_sdk_mode_needs_silence_and_can_be_asked_for() -> None:
    point = ControlPoint(VERITY_SENSE)
    ask(point, "0203")
    assert ask(point, "0209") == "f002090c00"
    ask(point, "0303")
    assert ask(point, "0209") == "f002090000"
    assert ask(point, "06") == "f00600000001"
    # No intervals in this mode, and it cannot be left before all is silent.
    assert ask(point, "0203") == "f002030300"
    ask(point, START_PPG)
    assert ask(point, "0309") == "f003090c00"
    ask(point, "0301")
    assert ask(point, "0309") == "f003090000"
    assert ask(point, "06") == "f00600000000"


def test_the_settings_of_the_sdk_mode_can_be_asked_for_in_any() -> None:
    point = ControlPoint(VERITY_SENSE)
    wide = ask(point, "0402")
    assert wide[:4] == "f004"
    ask(point, "0209")
    assert ask(point, "0102")[4:] == wide[4:]


@pytest.mark.parametrize("product", [VERITY_SENSE, OH1, POLAR_360])
def test_what_has_no_samples_at_a_rate_has_no_waveform(product: Product) -> None:
    settings = {Setting.SAMPLE_RATE: 1}
    with pytest.raises(ValueError, match="PPI"):
        waveform(product, Measurement.PPI, settings, Wearer(), compressed=False)
    assert product.advertised.startswith("Polar ")


@given(
    st.lists(st.binary(max_size=24), max_size=8),
    st.sampled_from([VERITY_SENSE, OLD_VERITY_SENSE, OH1, POLAR_360]),
)
def test_whatever_it_hears_it_answers(commands: list[bytes], product: Product) -> None:
    point = ControlPoint(product)
    for command in commands:
        packets = point.answer(command, FULL_MTU)
        assert packets
        assert all(packet[0] in (0xF0, 0x01) for packet in packets)


@ON_BUMBLE
async def test_no_interval_is_from_before_it_was_put_on(sensor: MakeSensor, radio: Radio) -> None:
    sense = sensor()
    async with connection(NAME) as host:
        await open_pmd(host)
        await host.ask(CONTROL, "0203")
        await until(lambda: len(frames_of(host, 3)) >= 1)
        sense.apply(Fault(FaultKind.OFF_BODY, inf))
        off_s = radio.world.clock()
        # In the midst of the time that the frame after the next one is about.
        await until(lambda: radio.world.clock() >= off_s + 8.0)
        sense.clear(FaultKind.OFF_BODY)
        on_s = radio.world.clock()
        await until(lambda: len(frames_of(host, 3)) >= 2)
    times = sense.truth.samples("ppi").times
    assert not ((times > off_s) & (times < on_s)).any()
    assert (times > on_s).any()
