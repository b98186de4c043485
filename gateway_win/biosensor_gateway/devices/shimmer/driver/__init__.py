"""Driver for the Shimmer3 and Shimmer3R: settings, and setup of a device."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np
import structlog
from pydantic import Field, field_validator

from biosensor_common.errors import ProtocolError, ProtocolReason
from biosensor_gateway.devices.driver import Connected, DriverEntry, by_port_name, own_settings
from biosensor_gateway.devices.shimmer import SPEC
from biosensor_gateway.devices.shimmer.driver import calibration, messages
from biosensor_gateway.devices.shimmer.driver import calibration as exg
from biosensor_gateway.devices.shimmer.driver.calibration import (
    Exg,
    Kinematic,
    Registers,
    Typical,
    Use,
    electrodes_on,
)
from biosensor_gateway.devices.shimmer.driver.channels import Channel, Layout
from biosensor_gateway.devices.shimmer.driver.connection import Prepared, ShimmerDriver
from biosensor_gateway.devices.shimmer.driver.conversation import (
    SHIMMER3R,
    Conversation,
    Kind,
    ask_for_the_state,
    expansion_board,
    make_right,
    refuse_if_left,
)
from biosensor_gateway.devices.shimmer.driver.messages import (
    TICKS_PER_S,
    Calibration,
    ExgRegisters,
    Inquiry,
    PressureChip,
    PressureCoefficients,
    divisor_for,
)
from biosensor_gateway.devices.shimmer.driver.packets import Batch, PacketEmitter
from biosensor_gateway.devices.shimmer.driver.signals import (
    MOTION,
    SENSORS,
    Signal,
    air_signals,
    are_real,
    compensation,
    exg_signal,
    has_air,
    has_exg,
    motion_on,
    motion_signals,
    sensor,
    status_places,
)
from biosensor_gateway.settings.models import DeviceSettings

if TYPE_CHECKING:
    from biosensor_gateway.streaming.sink import DeviceSink

EXG_BOARDS = frozenset({37, 47, 59})

_log = structlog.get_logger("biosensor_gateway.shimmer")

_OLDER_CHIPS: Mapping[str, Typical] = {
    "acc_low_noise": calibration.KXRB5_ACCEL,
    "acc_wide_range": calibration.LSM303DLHC_ACCEL,
    "gyro": calibration.MPU9150_GYRO,
    "mag": calibration.LSM303DLHC_MAG,
}
_NEWER_CHIPS: Mapping[str, Typical] = {
    "acc_low_noise": calibration.KXTC9_ACCEL,
    "acc_wide_range": calibration.LSM303AH_ACCEL,
    "gyro": calibration.MPU9150_GYRO,
    "mag": calibration.LSM303AH_MAG,
}
_CHIPS_OF_3R: Mapping[str, Typical] = {
    "acc_low_noise": calibration.LSM6DSV_ACCEL,
    "acc_wide_range": calibration.LIS2DW12_ACCEL,
    "gyro": calibration.LSM6DSV_GYRO,
    "mag": calibration.LIS2MDL_MAG,
}
QUALITY_PERIOD_S = 10.0


async def _pressure_coefficients(talk: Conversation, kind: Kind) -> PressureCoefficients | None:
    """Return the coefficients of the device's pressure sensor; None if unavailable.

    Raises
    ------
    TransportError
        As for :meth:`Conversation.ask`.
    """
    asked = [messages.GET_BMP180_COEFFICIENTS, messages.GET_BMP280_COEFFICIENTS]
    if kind.tells_pressure_chip:
        asked = [messages.GET_PRESSURE_COEFFICIENTS]
    try:
        for command in asked:
            coefficients = await talk.ask(command, PressureCoefficients)
            # A BMP581 needs no coefficients and has none.
            if coefficients.chip == PressureChip.BMP581 or are_real(coefficients):
                return coefficients
    except ProtocolError as error:
        _log.warning("the pressure sensor is unknown", cause=str(error))
    return None


async def _motion_calibrations(
    talk: Conversation,
    kind: Kind,
    layout: Layout,
    present: Inquiry,
    air: PressureCoefficients | None,
    remarks: dict[str, str],
) -> list[tuple[str, Kinematic]]:
    """Return the calibration of each motion sensor in the packets.

    It comes from the device's memory; sensors without one there get typical values of their chip.

    Parameters
    ----------
    present
        Setup of the device, with the ranges of its sensors.
    air
        Coefficients of the pressure sensor, if known, which identify the generation of chips.
    remarks
        Gets which sensors have typical values.

    Raises
    ------
    TransportError
        As for :meth:`Conversation.ask`.
    """
    names = motion_on(layout)
    memory = await _memory(talk) if names else b""
    found = {name: calibration.stored(memory, MOTION[name].block) for name in names}
    without = [name for name, each in found.items() if each is None]
    if without:
        remarks["calibration"] = (
            f"typical values are used where there was no calibration: {', '.join(without)}"
        )
    typical = typical_calibrations(kind, layout, present, air)
    return [(name, found[name] or each) for name, each in typical]


def typical_calibrations(
    kind: Kind, layout: Layout, present: Inquiry, air: PressureCoefficients | None
) -> list[tuple[str, Kinematic]]:
    """Return the chip makers' typical calibrations of the sensors in the packets.

    The parameters are those of `_motion_calibrations`.
    """
    chips, ranges = _chips(kind, layout, air), _ranges(kind, present)
    return [(name, chips[name].at(ranges[name])) for name in motion_on(layout)]


async def _memory(talk: Conversation) -> bytes:
    try:
        return (await talk.ask(messages.GET_ALL_CALIBRATION, Calibration)).data
    except ProtocolError as error:
        _log.warning("the device does not report its calibration", cause=str(error))
        return b""


def _chips(kind: Kind, layout: Layout, air: PressureCoefficients | None) -> Mapping[str, Typical]:
    if kind.hardware == SHIMMER3R:
        return _CHIPS_OF_3R
    has_newer_mag = Channel.MAG_X in layout.channels and not layout.has_older_mag
    # The pressure sensor and the motion chips were replaced at the same time.
    has_newer_air = air is not None and air.chip == PressureChip.BMP280
    return _NEWER_CHIPS if has_newer_mag or has_newer_air else _OLDER_CHIPS


def _ranges(kind: Kind, present: Inquiry) -> dict[str, int]:
    """Return the range settings from the configuration bytes of the firmware."""
    setup = present.setup
    gyro = setup[2] & 3
    is_3r = kind.hardware == SHIMMER3R
    if is_3r:
        gyro |= (setup[4] >> 2 & 1) << 2
    return {
        "acc_low_noise": setup[3] >> 6 if is_3r else 0,
        "acc_wide_range": setup[0] >> 2 & 3,
        "gyro": gyro,
        "mag": 0 if is_3r else setup[2] >> 5,
    }


class Wanted(NamedTuple):
    """How to measure."""

    sensors: frozenset[str] | None = None  # Names of `SENSORS`; None keeps the current ones.
    divisor: int | None = None  # 32768 Hz divided by the sample rate; None keeps the current one.
    # bits, gain, lead_off: settings of the ExG, if it is in `sensors`.
    bits: int = 24
    gain: int | None = None
    lead_off: bool = False

    @property
    def use(self) -> Use | None:
        """Wanted use of the ExG chips."""
        return next((use for use in Use if use in (self.sensors or ())), None)


async def set_up(talk: Conversation, kind: Kind, wanted: Wanted, name: str) -> Measurement:
    """Set up the device and return how it measures, without starting it.

    Settings are written to the device's flash, so correct ones are not written again.

    Raises
    ------
    ProtocolError
        ``REFUSED`` if it does not accept a setting; ``UNSUPPORTED`` if no supported sensor is on;
        or as for :meth:`Conversation.ask`.
    TransportError
        As for :meth:`Conversation.ask`.
    """
    denied = await ask_for_the_state(talk, kind)
    remarks: dict[str, str] = {}
    present = await make_right(talk, partial(_changes, wanted=wanted), name)
    if wanted.use is not None:
        await _set_exg_up(talk, wanted, wanted.use, present, name)
    layout = kind.layout(present.channels)
    air = await _pressure_coefficients(talk, kind) if has_air(layout) else None
    motion = await _motion_calibrations(talk, kind, layout, present, air, remarks)
    signals = motion_signals(layout, motion)
    compensate = air and compensation(air, present.pressure_oversampling)
    if compensate:
        signals += air_signals(layout, compensate)
    elif has_air(layout):
        why = "the coefficients of the pressure sensor are unknown"
        denied |= {"pressure": why, "temp": why}
    chips = Exg(await _registers(talk)) if has_exg(layout) else None
    if chips is not None:
        signals.insert(0, exg_signal(layout, chips))
        board = await expansion_board(talk, name)
        if board is not None and board not in EXG_BOARDS:
            remarks["board"] = (
                f"the expansion board ({board}) is not an ExG board, so {signals[0].data_name} "
                "has no meaning"
            )
        if chips.is_test_signal:
            remarks["test signal"] = "the ExG measures a test signal, not the body"
    if not signals:
        message = f"{name}: no sensor that can be read is on; set sensors"
        raise ProtocolError(ProtocolReason.UNSUPPORTED, message)
    tells = chips is not None and chips.detects_lead_off and chips.use is Use.ECG
    status_at = status_places(layout) if tells else None
    return Measurement(layout, present.divisor, tuple(signals), status_at, denied, remarks)


def _changes(present: Inquiry, wanted: Wanted) -> dict[str, bytes]:
    """Return the necessary commands by the setting that they change."""
    changes: dict[str, bytes] = {}
    if wanted.sensors is not None:
        on = [sensor(each, wanted.bits) for each in sorted(wanted.sensors)]
        if set(present.channels) != {channel for each in on for channel in each.channels}:
            changes["sensors"] = messages.set_sensors(sum(each.mask for each in on))
    if wanted.divisor not in (None, present.divisor):
        changes["sampling rate"] = messages.set_sampling_rate(wanted.divisor)
    return changes


async def _registers(talk: Conversation) -> Registers:
    first = await talk.ask(messages.get_exg_registers(0), ExgRegisters)
    second = await talk.ask(messages.get_exg_registers(1), ExgRegisters)
    return first.data.ljust(exg.REGISTERS, b"\0"), second.data.ljust(exg.REGISTERS, b"\0")


async def _set_exg_up(
    talk: Conversation, wanted: Wanted, use: Use, present: Inquiry, name: str
) -> None:
    gain = wanted.gain or exg.DEFAULT_GAIN[use]
    rate_hz = messages.TICKS_PER_S / present.divisor
    right = exg.registers_for(use, gain, rate_hz, lead_off=wanted.lead_off)
    changes = _exg_changes(await _registers(talk), right)
    for command in changes.values():
        await talk.tell(command)
    if changes:
        refuse_if_left(_exg_changes(await _registers(talk), right), name)


def _exg_changes(present: Registers, right: Registers) -> dict[str, bytes]:
    return {
        f"ExG chip {chip + 1}": messages.set_exg_registers(chip, right[chip])
        for chip in (0, 1)
        if not exg.are_same(present[chip], right[chip])
    }


WAVEFORMS = frozenset(stream.data_name for stream in SPEC.streams if stream.is_regular)

AS_IT_IS = "device"
SLOWEST_HZ, FASTEST_HZ = 1.0, 2048.0


class Shimmer3Settings(DeviceSettings):
    """Settings of one Shimmer3 or Shimmer3R."""

    port: str = Field(
        min_length=1,
        description="Serial port of the paired Shimmer, COM7 or /dev/rfcomm0 for instance, or its "
        "Bluetooth address, 00:06:66:AA:BB:CC for instance, or socket://HOST:NUMBER.",
        examples=["/dev/rfcomm0"],
    )
    sensors: str = Field(
        default=AS_IT_IS,
        max_length=100,
        description="Which sensors are on: device for those that the Shimmer was configured with, "
        f"or names separated by commas, from {', '.join(SENSORS)}; ecg and emg exclude each "
        "other.",
    )
    rate_hz: float = Field(
        default=0.0,
        ge=0.0,
        le=FASTEST_HZ,
        description="Sampling rate of all sensors in Hz, 1 to 2048, of which the device uses the "
        "nearest that divides 32768; 0 keeps the one that the Shimmer was configured with.",
    )
    exg_bits: Literal[16, 24] = Field(
        default=24, description="Resolution of the ecg or emg in sensors."
    )
    exg_gain: Literal["usual", 1, 2, 3, 4, 6, 8, 12] = Field(
        default="usual",
        description="Amplification of the ecg or emg in sensors; the usual is 4 for ecg and 12 for "
        "emg.",
    )
    lead_off: bool = Field(
        default=False,
        description="Whether the ecg in sensors reports electrodes that came off; this sends a "
        "current of 22 nA through them.",
    )

    @field_validator("sensors")
    @classmethod
    def _known(cls, text: str) -> str:
        if text == AS_IT_IS:
            return text
        names = _names(text)
        for name in names:
            if name not in SENSORS:
                known = ", ".join(SENSORS)
                raise ValueError(f"should be {AS_IT_IS}, or names from {known}, but has {name!r}")
        if names >= set(Use):
            raise ValueError("should have ecg or emg, which need the same chips, but has both")
        return text

    @field_validator("rate_hz")
    @classmethod
    def _possible(cls, rate_hz: float) -> float:
        if 0 < rate_hz < SLOWEST_HZ:
            raise ValueError("should be 0, or from 1 to 2048")
        return rate_hz

    @property
    def wanted(self) -> Wanted:
        """How to measure."""
        return Wanted(
            None if self.sensors == AS_IT_IS else _names(self.sensors),
            divisor_for(self.rate_hz) if self.rate_hz else None,
            self.exg_bits,
            None if self.exg_gain == "usual" else self.exg_gain,
            self.lead_off,
        )


def _names(text: str) -> frozenset[str]:
    return frozenset(name.strip() for name in text.split(","))


def _connected(measurement: Measurement) -> Connected:
    """Return the rates of all streams, and which ones are off."""
    off = WAVEFORMS - set(measurement.streams)
    if measurement.status_at is None:
        off |= {"quality"}
    off -= measurement.denied.keys()
    rates = dict.fromkeys(WAVEFORMS, measurement.rate_hz)
    return Connected(rates=rates, silent=off, denied=measurement.denied)


def _make(settings: DeviceSettings, sink: DeviceSink) -> Callable[[], ShimmerDriver]:
    """Share one emitter between all connections, to follow the device's clock across them."""
    own = own_settings(Shimmer3Settings, settings)
    emitter = ShimmerEmitter(sink)

    async def prepare(talk: Conversation, kind: Kind) -> Prepared:
        measurement = await set_up(talk, kind, own.wanted, own.port)
        begin = partial(emitter.started, measurement)
        known = _connected(measurement)
        layout, divisor = measurement.layout, measurement.divisor
        return Prepared(layout, divisor, begin, known, measurement.remarks)

    return lambda: ShimmerDriver(own.port, sink, emitter, prepare)


recognise = by_port_name("shimmer", r"Shimmer3R?-([0-9A-Fa-f]{4})(?:-BT)?")
DRIVER = DriverEntry(Shimmer3Settings, _make, recognise=recognise)


@dataclass(frozen=True, slots=True)
class Measurement:
    """The setup of a device."""

    layout: Layout
    divisor: int  # The sample rate is 32768 Hz divided by it.
    signals: tuple[Signal, ...]
    # Positions of the status of both ExG chips; None without lead-off detection, so there is no
    # `quality`.
    status_at: tuple[int, int] | None = None
    # What the device refuses and why, by data name; and why values may be wrong.
    denied: Mapping[str, str] = field(default_factory=dict[str, str])
    remarks: Mapping[str, str] = field(default_factory=dict[str, str])

    @property
    def rate_hz(self) -> float:
        """Sample rate."""
        return TICKS_PER_S / self.divisor

    @property
    def streams(self) -> tuple[str, ...]:
        """Data names of the streams in a packet."""
        return tuple(signal.data_name for signal in self.signals)


@dataclass(slots=True)
class _Told:
    """The last emitted electrode state, and its device time."""

    quality: tuple[float, ...] | None = field(default=None)
    time_s: float = 0.0


class ShimmerEmitter(PacketEmitter):
    """Converts packets to samples; one instance per device, over all its connections."""

    def __init__(self, sink: DeviceSink) -> None:
        super().__init__(sink, "shimmer")
        self._measurement: Measurement | None = None
        self._told = _Told()

    def started(self, measurement: Measurement) -> None:
        """Prepare for packets of a new connection."""
        self._measurement = measurement
        self._expect(measurement.divisor, measurement.streams)
        self._told = _Told()

    def _emit(self, batch: Batch) -> None:
        assert self._measurement is not None
        raw = np.array(batch.rows, np.float64)
        for signal in self._measurement.signals:
            self._sink.emit(signal.data_name, signal.convert(raw[:, signal.at]), batch.times)
        if self._measurement.status_at is not None:
            self._emit_quality(batch, self._measurement.status_at)

    def _emit_quality(self, batch: Batch, status_at: tuple[int, int]) -> None:
        for row, time_s in zip(batch.rows, batch.times, strict=True):
            on = electrodes_on(row[status_at[0]], row[status_at[1]])
            quality = (float(all(on)), *on)
            is_due = time_s - self._told.time_s >= QUALITY_PERIOD_S
            if quality != self._told.quality or is_due:
                self._told = _Told(quality, time_s)
                self._sink.emit("quality", [quality], [time_s])
