"""The two ExG chips (ADS1292R): registers, scale, and lead-off detection.

Registers are as in Texas Instruments' data sheet SBAS502; the assignment of electrodes and the
usual settings for ECG and EMG are from Shimmer's manuals and APIs. The firmware's status byte
consists of 1, two zeros, and then from the highest bit RLD, IN2N, IN2P, IN1N, IN1P, each 1 while
that lead is off.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import ArrayLike

from biosensor_gateway.devices.shimmer.driver.calibration import Floats

REGISTERS = 10
_CONFIG1, _CONFIG2, _LOFF, _CH1SET, _CH2SET, _RLD_SENS, _LOFF_SENS = range(7)

_REFERENCE_UV = 2.42e6
_FULL_SCALE = {24: (1 << 23) - 1, 16: (1 << 15) - 1}
# For 16 bits, the firmware takes the bits below the highest of the 24, which doubles the gain.
_FIRMWARE_GAIN = {24: 1, 16: 2}
_GAINS = {0: 6, 1: 1, 2: 2, 3: 3, 4: 4, 5: 8, 6: 12}
_GAIN_SHIFT, _GAIN_MASK, _INPUT_MASK = 4, 0x7, 0xF
_TEST_SIGNAL, _CHANNEL_3 = 0x5, 0x9
_COMPARATORS_ON = 0x40
# Set by the firmware itself in chip 1, on boards where both chips share a clock.
_CLOCK_OUT = 0x08
_SLOWEST_HZ, _FASTEST_SETTING = 125.0, 6

_ECG = (bytes.fromhex("00a010 40402d 0000 0203"), bytes.fromhex("00a010 404700 0000 0201"))
_EMG = (bytes.fromhex("00a010 696020 0000 0203"), bytes.fromhex("00a010 e1e100 0000 0201"))
# Lead-off current 22 nA; an input is off above 90 % or below 10 % of the supply.
_DIRECT_CURRENT = 0x54
_RLD_SENSED = 0x10
_SENSED_INPUTS = (0x07, 0x04)


class Use(StrEnum):
    """Use of the chips; the values are data names."""

    ECG = "ecg"
    EMG = "emg"


DEFAULT_GAIN = {Use.ECG: 4, Use.EMG: 12}
GAINS = tuple(sorted(_GAINS.values()))

Registers = tuple[bytes, bytes]
"""Ten registers of each chip."""


@dataclass(frozen=True, slots=True)
class Exg:
    """The setup of both chips."""

    registers: Registers

    @property
    def use(self) -> Use:
        """EMG if the first channel of chip 1 is routed to channel 3, else ECG."""
        is_emg = self.registers[0][_CH1SET] & _INPUT_MASK == _CHANNEL_3
        return Use.EMG if is_emg else Use.ECG

    @property
    def is_test_signal(self) -> bool:
        """Whether the first channel measures the chip's own square wave."""
        return self.registers[0][_CH1SET] & _INPUT_MASK == _TEST_SIGNAL

    @property
    def detects_lead_off(self) -> bool:
        """Whether lead-off detection is on."""
        return bool(self.registers[0][_CONFIG2] & _COMPARATORS_ON)

    def gain(self, chip: int, channel: int) -> int:
        """Return the gain of a channel (1 or 2) of a chip (0 or 1); 1 for a reserved setting."""
        register = self.registers[chip][(_CH1SET, _CH2SET)[channel - 1]]
        return _GAINS.get(register >> _GAIN_SHIFT & _GAIN_MASK, 1)


def registers_for(use: Use, gain: int, rate_hz: float, *, lead_off: bool) -> Registers:
    """Return the registers of both chips.

    Parameters
    ----------
    gain
        One of `GAINS`.
    rate_hz
        Sample rate of the device; the chips are set to the next higher rate.
    lead_off
        Whether to detect loose electrodes with direct current; only for ECG.
    """
    made = [bytearray(each) for each in (_ECG if use is Use.ECG else _EMG)]
    code = next(code for code, value in _GAINS.items() if value == gain)
    for chip, registers in enumerate(made):
        registers[_CONFIG1] = _rate_setting(rate_hz)
        if use is Use.ECG or chip == 0:
            for at in (_CH1SET, _CH2SET):
                registers[at] = registers[at] & ~(_GAIN_MASK << _GAIN_SHIFT) | code << _GAIN_SHIFT
        if lead_off and use is Use.ECG:
            registers[_CONFIG2] |= _COMPARATORS_ON
            registers[_LOFF] = _DIRECT_CURRENT
            registers[_LOFF_SENS] = _SENSED_INPUTS[chip]
            registers[_RLD_SENS] |= 0 if chip else _RLD_SENSED
    return bytes(made[0]), bytes(made[1])


def are_same(present: bytes, wanted: bytes) -> bool:
    """Whether a chip is set up as wanted, ignoring what the firmware sets itself."""
    without = bytearray(present)
    if len(without) > _CONFIG2:
        without[_CONFIG2] &= ~_CLOCK_OUT
    return bytes(without) == wanted


def microvolts(raw: ArrayLike, gain: int, bits: int) -> Floats:
    """Return the voltage between two electrodes [uV].

    Parameters
    ----------
    raw
        Signed values of a channel.
    gain
        Gain of the chip's amplifier.
    bits
        16 or 24, as sent.
    """
    scale = _REFERENCE_UV / (gain * _FIRMWARE_GAIN[bits]) / _FULL_SCALE[bits]
    return np.asarray(raw, np.float64) * scale


def electrodes_on(status_1: int, status_2: int) -> tuple[float, float, float, float]:
    """Return from both chips' status whether RA, LA, LL and V1 are on the skin, 1 or 0."""
    off = status_1 >> 1 & 1, status_1 >> 2 & 1, status_1 & 1, status_2 >> 2 & 1
    right_arm, left_arm, left_leg, chest = (float(not each) for each in off)
    return right_arm, left_arm, left_leg, chest


def _rate_setting(rate_hz: float) -> int:
    setting = 0
    while rate_hz >= _SLOWEST_HZ * (1 << setting) and setting < _FASTEST_SETTING:
        setting += 1
    return setting
