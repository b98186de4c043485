"""Which channels are recorded, and with which period."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from biosensor_common.errors import ProtocolError, ProtocolReason
from biosensor_gateway.devices.vernier_respiration_belt.driver.conversation import (
    BeltChannels,
    choose_channels,
)
from biosensor_gateway.devices.vernier_respiration_belt.driver.protocol import Channel


def channel(
    number: int, description: str, least: int = 10_000, most: int = 60_000_000, step: int = 10_000
) -> Channel:
    return Channel(number, description, "", least, most, step)


FORCE, RATE = channel(1, "Force"), channel(2, "Respiration Rate")


def test_force_and_rate_are_found_by_name_wherever_they_are() -> None:
    chosen = choose_channels(
        [channel(0, "Steps"), channel(7, "FORCE"), channel(9, "Respiration Rate")]
    )
    assert (chosen.force.number, chosen.rate.number) == (7, 9)
    assert chosen.mask == 0b10_1000_0000


@pytest.mark.parametrize("channels", [[], [FORCE], [RATE], [channel(1, "Temperature")]])
def test_another_device_is_unsupported(channels: list[Channel]) -> None:
    with pytest.raises(ProtocolError) as caught:
        choose_channels(channels)
    assert caught.value.reason is ProtocolReason.UNSUPPORTED


@pytest.mark.parametrize(
    ("wanted_us", "least", "most", "step", "period_us"),
    [
        (100_000, 10_000, 60_000_000, 10_000, 100_000),
        (104_000, 10_000, 60_000_000, 10_000, 100_000),
        (50_000, 75_000, 60_000_000, 10_000, 80_000),
        (900_000, 10_000, 255_000, 10_000, 250_000),
        (100_000, 50_000, 60_000_000, 0, 100_000),
        (100_000, 200_000, 50_000, 10_000, 200_000),
    ],
)
def test_the_period_is_one_that_the_belt_can_have(
    wanted_us: int, least: int, most: int, step: int, period_us: int
) -> None:
    limited = channel(2, "Respiration Rate", least, most, step)
    assert BeltChannels(FORCE, limited).period_us(wanted_us) == period_us


@given(*[st.integers(1, 2**32 - 1)] * 3, st.integers(50_000, 1_000_000))
def test_any_limits_give_a_period(least: int, most: int, step: int, wanted_us: int) -> None:
    limited = channel(2, "Respiration Rate", least, most, step)
    both = BeltChannels(channel(1, "Force", 1, 2**64 - 1, 1), limited)
    period = both.period_us(wanted_us)
    assert period >= least
    assert period % step == 0
