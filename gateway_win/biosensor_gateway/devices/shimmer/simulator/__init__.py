"""Virtual Shimmers with several expansion boards.

::

    with World() as world, SimulatedExgUnit(world) as device:
        serial.serial_for_url(device.port, 115200)
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import ClassVar

import numpy as np

from biosensor_gateway.devices.shimmer.simulator.device import SimulatedShimmer
from biosensor_gateway.devices.shimmer.simulator.sampler import Block
from biosensor_gateway.devices.shimmer.simulator.sensors import (
    CHANNELS_16,
    CHANNELS_24,
    ECG_WITH_LEAD_OFF,
    EMG,
    GRAVITY_MS2,
    GYRO,
    LN_ACCEL,
    MAG,
    MASKS_16,
    MASKS_24,
    PRESSURE,
    STATUS,
    TEMPERATURE,
    WR_ACCEL,
    AirSensor,
    Bmp180,
    Bmp280,
    Bmp581,
    ExgChips,
    MotionSensor,
    Words,
    acting_on,
    memory_of,
    tuples,
    voltages,
)
from biosensor_gateway.devices.shimmer.simulator.wire import (
    OLDER_SHIMMER3,
    SHIMMER3R,
    Flash,
    Memory,
)
from biosensor_gateway.simulation.faults import Effects, FaultKind, Untidiness
from biosensor_gateway.simulation.truth import (
    NO_INTERVALS,
    TELLS_ITS_RATE,
    Expected,
    Gap,
    LossTolerance,
)
from biosensor_gateway.simulation.virtual_device import Filled
from biosensor_gateway.simulation.wearer import Floats, Wearer

MOTION_AND_AIR = 0x000080 | 0x001000 | 0x000040 | 0x000020 | 0x040000
_ONE_USE = Filled(None, "its ExG chips measure an ECG")
_EMG_INSTEAD = Filled(None, "its ExG chips measure an EMG")
_NO_EXG = Filled(None, "it has no ExG board")
_DIVIDER = 256
_WAVEFORMS = (
    *("ecg", "emg", "acc_low_noise", "acc_wide_range", "gyro", "mag", "pressure", "temp"),
)
_EFFECTS_WITHOUT_ELECTRODES: Effects[SimulatedShimmer] = MappingProxyType(
    {
        kind: effect
        for kind, effect in SimulatedShimmer.effects.items()
        if kind is not FaultKind.OFF_BODY
    }
)

_LN = MotionSensor(
    *("acc_low_noise", LN_ACCEL, (2066.0, 2041.0, 2051.0), (84.0, 83.0, 82.0)),
    ((0.01, -1, 0), (-0.99, 0.02, 0), (0, 0.01, -1)),
    GRAVITY_MS2,
    (0, 4095),
)
_GYRO = MotionSensor(
    *("gyro", GYRO, (12.0, -31.0, 5.0), (65.5, 65.12, 65.98)),
    ((0, -1, 0.01), (-1, 0, 0), (0.01, 0, -0.99)),
    word_scale=100,
)
_NEWER_MAG = MotionSensor(
    *("mag", MAG, (-40.0, 133.0, 77.0), (331.0, 340.0, 327.0)),
    ((0, -1, 0), (1, 0.02, 0), (0, 0, -1)),
)
_NEWER_WR = MotionSensor(
    *("acc_wide_range", WR_ACCEL, (20.0, -11.0, 64.0), (1669.0, 1674.0, 1680.0)),
    ((0, -1, 0), (1, 0, 0.01), (0, 0, -1)),
    GRAVITY_MS2,
)
_OLDER_MAG = MotionSensor(
    *("mag", MAG, (9.0, -70.0, 31.0), (561.0, 570.0, 498.0)),
    ((-1, 0, 0), (0, 1, 0), (0.02, 0, -1)),
)
# Not calibrated: typical values of the chip for 2 g.
_OLDER_WR = MotionSensor(
    *("acc_wide_range", WR_ACCEL, (0.0, 0.0, 0.0), (1631.0, 1631.0, 1631.0)),
    ((-1, 0, 0), (0, 1, 0), (0, 0, -1)),
    GRAVITY_MS2,
)

EXPECTED = Expected(
    # The agent repeats it every ten seconds.
    by_agent=frozenset({"quality"}),
    impossible={FaultKind.REPEAT: NO_INTERVALS, Untidiness.RATE: TELLS_ITS_RATE},
    # Only the battery can be denied: measurements are set up before they are requested.
    deniable=1,
    gaps={
        # The firmware stops streaming when the link is lost.
        FaultKind.DROP: Gap.STOPPED,
        FaultKind.REFUSE: Gap.STOPPED,
        FaultKind.LATE: Gap.STOPPED,
        FaultKind.RESTART: Gap.STOPPED,
        # The radio link stays, so it only stops, silently, when the host closes the port.
        FaultKind.STALL: Gap.UNKNOWN,
        # It answers but sends no data, so whether it measures is unknown.
        FaultKind.FORGET: Gap.UNKNOWN,
        # It is restarted meanwhile, and since when it measures is unknown.
        FaultKind.UNREADABLE: Gap.UNKNOWN,
    },
    # When the link breaks, a quarter of a second of data may be in its radio and in the buffers of
    # a busy host's system.
    loss_tolerance=LossTolerance(over_break=32),
)
WITHOUT_ELECTRODES = replace(
    EXPECTED,
    impossible={
        **EXPECTED.impossible,
        FaultKind.OFF_BODY: "its electrodes do not report contact",
    },
)

_Values = dict[str, Sequence[tuple[float, ...]]]


class _UnitMeter:
    """The sensors of a unit during one stream.

    Parameters
    ----------
    channels
        Channel ids in packet order; sensors that the unit does not have read 0.
    motion, air, exg
        Its sensors.
    is_worn
        Called once per block.
    """

    def __init__(
        self,
        channels: tuple[int, ...],
        motion: Sequence[MotionSensor],
        air: AirSensor,
        exg: ExgChips,
        wearer: Wearer,
        is_worn: Callable[[], bool],
    ) -> None:
        self._channels = channels
        self._motion = [each for each in motion if set(each.channels) <= set(channels)]
        self._air = air
        self._exg = exg
        self._wearer = wearer
        self._is_worn = is_worn

    def measure(self, t: Floats) -> Block:
        """Return the measurements at these times, on the wearer's clock [s]."""
        columns: dict[int, Words] = {}
        values: _Values = {}
        for sensor in self._motion:
            counts = sensor.counts(acting_on(self._wearer, sensor.data_name, t))
            columns.update(zip(sensor.channels, counts.T, strict=True))
            values[sensor.data_name] = tuples(sensor.values(counts))
        if {PRESSURE, TEMPERATURE} <= set(self._channels):
            self._measure_air(t, columns, values)
        if set(STATUS) & set(self._channels):
            self._measure_exg(t, columns, values)
        zeros = np.zeros(t.size, np.int64)
        chosen = [columns.get(channel, zeros).tolist() for channel in self._channels]
        return Block(list(zip(*chosen, strict=True)), values)

    def _measure_air(self, t: Floats, columns: dict[int, Words], values: _Values) -> None:
        raw_t, raw_p = self._air.raw(self._wearer, t)
        columns.update({TEMPERATURE: raw_t, PRESSURE: raw_p})
        pairs = zip(raw_t.tolist(), raw_p.tolist(), strict=True)
        airs = [self._air.air(each_t, each_p) for each_t, each_p in pairs]
        values["pressure"] = [(pascals,) for pascals, _ in airs]
        values["temp"] = [(degrees,) for _, degrees in airs]

    def _measure_exg(self, t: Floats, columns: dict[int, Words], values: _Values) -> None:
        worn, chips = self._is_worn(), self._exg
        signals = voltages(self._wearer, t, is_emg=chips.is_emg, worn=worn)
        leads: list[Floats] = []
        for chip in (0, 1):
            bits = 24 if CHANNELS_24[chip][0] in self._channels else 16
            sent = (CHANNELS_24 if bits == 24 else CHANNELS_16)[chip]
            columns[STATUS[chip]] = np.full(t.size, chips.status(chip, worn=worn))
            for channel, number in enumerate(sent):
                counts = chips.counts(chip, channel, signals[2 * chip + channel], bits)
                columns[number] = counts
                is_sent = number in self._channels
                microvolts = chips.microvolts(chip, channel, counts, bits)
                leads.append(microvolts if is_sent else np.full(t.size, np.nan))
        chosen = leads[:2] if chips.is_emg else [leads[0], leads[1], leads[3]]
        values["emg" if chips.is_emg else "ecg"] = tuples(np.stack(chosen, axis=1))
        if not chips.is_emg and chips.detects and set(STATUS) <= set(self._channels):
            values["quality"] = [self._quality(worn=worn)] * t.size

    def _quality(self, *, worn: bool) -> tuple[float, ...]:
        first, second = (self._exg.status(chip, worn=worn) for chip in (0, 1))
        # Right arm, left arm, left leg, chest.
        is_open = first & 2, first & 4, first & 1, second & 4
        electrodes = [float(not each) for each in is_open]
        return (float(not any(is_open)), *electrodes)


class _Unit(SimulatedShimmer):
    """Base class of units with several expansion boards."""

    sensor = "shimmer"
    rates_hz = MappingProxyType(dict.fromkeys(_WAVEFORMS, 32768 / _DIVIDER))
    # motion, air: sensors on the main board.
    motion: ClassVar[Sequence[MotionSensor]]
    air: ClassVar[AirSensor]
    # Initial registers of the ExG chips.
    registers: ClassVar[Sequence[bytes]] = (bytes(10), bytes(10))
    sensors: ClassVar[int]  # Mask of the sensors that are on initially.
    setup: ClassVar[bytes] = bytes.fromhex("019b0900")

    def _new_flash(self, name: str) -> Flash:
        exg_registers = [bytearray(each) for each in self.registers]
        return Flash(name, self.sensors, _DIVIDER, bytearray(self.setup), exg_registers)

    def _meter(self, channels: tuple[int, ...]) -> _UnitMeter:
        chips = ExgChips([bytes(each) for each in self._flash.exg])
        return _UnitMeter(channels, self.motion, self.air, chips, self.wearer, lambda: self._worn)


class SimulatedExgUnit(_Unit):
    """An ExG unit with all sensors on and electrodes placed for an ECG.

    Its `truth` contains all streams except ``emg``, in declared units, and ``quality`` at each
    change.
    """

    expected = EXPECTED
    filled = MappingProxyType({"emg": _ONE_USE})
    motion = (_LN, _GYRO, _NEWER_MAG, _NEWER_WR)
    air = Bmp280()
    memory = Memory(
        card=(47, 3, 0),
        calibration=memory_of(*motion),
        pressure_coefficients=air.coefficients,
    )
    registers = ECG_WITH_LEAD_OFF
    sensors = MOTION_AND_AIR | sum(MASKS_24)


class SimulatedEmgUnit(SimulatedExgUnit):
    """An ExG unit with electrodes placed for an EMG, sent by one chip with 16 bits."""

    effects = _EFFECTS_WITHOUT_ELECTRODES
    expected = WITHOUT_ELECTRODES
    filled = MappingProxyType({"ecg": _EMG_INSTEAD, "quality": _EMG_INSTEAD})
    usual_name = "Shimmer3-3D2C"
    registers = EMG
    sensors = MOTION_AND_AIR | MASKS_16[0]


class SimulatedImuUnit(_Unit):
    """An IMU unit of the older series."""

    effects = _EFFECTS_WITHOUT_ELECTRODES
    expected = WITHOUT_ELECTRODES
    filled = MappingProxyType(dict.fromkeys(("ecg", "emg", "quality"), _NO_EXG))
    usual_name = "Shimmer3-6A1F"
    motion = (_LN, _GYRO, _OLDER_MAG, _OLDER_WR)
    air = Bmp180()
    memory = Memory(
        model=OLDER_SHIMMER3,
        card=(31, 2, 0),
        calibration=memory_of(*motion),
        pressure_chip=0,
        pressure_coefficients=air.coefficients,
    )
    sensors = MOTION_AND_AIR
    # 2 g, 500 deg/s, 1.3 gauss.
    setup = bytes.fromhex("519b3900")


_LN_OF_3R = MotionSensor(
    *("acc_low_noise", LN_ACCEL, (14.0, -8.0, 21.0), (1670.0, 1668.0, 1675.0)),
    ((-1, 0.01, 0), (0, 1, 0), (0, 0, -0.99)),
    GRAVITY_MS2,
)
_GYRO_OF_3R = MotionSensor(
    *("gyro", GYRO, (3.0, 9.0, -14.0), (57.14, 57.3, 56.9)),
    ((-1, 0, 0), (0, 1, 0.01), (0, 0, -1)),
    word_scale=100,
)
_WR_OF_3R = MotionSensor(
    *("acc_wide_range", WR_ACCEL, (-30.0, 12.0, 4.0), (1671.0, 1690.0, 1660.0)),
    ((0, -1, 0), (-1, 0, 0), (0.01, 0, -1)),
    GRAVITY_MS2,
)
_MAG_OF_3R = MotionSensor(
    *("mag", MAG, (55.0, -20.0, 8.0), (335.0, 331.0, 342.0)),
    ((-1, 0, 0), (0, -1, 0), (0, 0.01, -1)),
)


class SimulatedShimmer3R(SimulatedExgUnit):
    """A Shimmer3R with an ExG board, all sensors on, and electrodes for an ECG."""

    usual_name = "Shimmer3R-71B4-BT"
    motion = (_LN_OF_3R, _GYRO_OF_3R, _MAG_OF_3R, _WR_OF_3R)
    air = Bmp581()
    memory = Memory(
        model=SHIMMER3R,
        card=(47, 5, 0),
        # This unit has no high-g accelerometer and no second magnetometer.
        calibration=memory_of(*motion, None, None),
        pressure_chip=3,
        pressure_coefficients=air.coefficients,
    )
    # 2 g, 500 deg/s.
    setup = bytes.fromhex("51040200000000")
