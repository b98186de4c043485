"""Carries out commands as the firmware does: changes its state, answers.

Pure: commands come in, messages without check go out; time and battery are asked of
the hardware.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

from biosensor_gateway.devices.shimmer3_gsr.simulator import battery
from biosensor_gateway.devices.shimmer3_gsr.simulator.wire import (
    ACK,
    IN_STREAM,
    NACK,
    TICKS_PER_S,
    Command,
    Firmware,
    Opcode,
    channels_of,
)

MAX_RATE_HZ = 4096
_NAME_LENGTH = 12
_CARD_LENGTH = 2048
_MOST_CARD_BYTES = 128
_LOG_AND_STREAM = 3
_SHIMMER3 = 3
# Board, revision, special revision; 48 is the unified GSR+ board.
_GSR_PLUS_CARD = bytes((48, 4, 0)).ljust(_CARD_LENGTH, b"\xff")
# Low-noise accelerometer: offset 2253, 92 counts per m/s^2, mounting; the other blocks unset.
_LN_ACCEL = bytes.fromhex("08cd08cd08cd005c005c005c009c009c000000009c")
_CALIBRATION = _LN_ACCEL.ljust(84, b"\xff")
_BLOCKED_WHILE_SENSING = frozenset(
    {
        Opcode.SET_SAMPLING_RATE,
        Opcode.SET_SENSORS,
        Opcode.SET_SETUP_BYTES,
        Opcode.SET_GSR_RANGE,
        Opcode.SET_EXPANSION_POWER,
        Opcode.SET_NAME,
    }
)


@dataclass
class Flash:
    """What a Shimmer keeps without power.

    Attributes
    ----------
    name
        Of the unit, at most 12 ASCII characters.
    sensors
        Mask of 24 bits.
    divider
        Ticks of 1/32768 s between two samples.
    setup
        Four bytes of set-up; the last holds the expansion power (bit 0) and the range
        of the skin conductance (bits 1 to 3).
    """

    name: str = "Shimmer_4E5F"
    sensors: int = 0x000080
    divider: int = 640
    setup: bytearray = field(default_factory=lambda: bytearray.fromhex("01ff0100"))

    @property
    def expansion_power(self) -> int:
        """Whether the probe has power, 0 or 1."""
        return self.setup[3] & 1

    @expansion_power.setter
    def expansion_power(self, on: int) -> None:
        self.setup[3] = self.setup[3] & ~1 | (1 if on else 0)

    @property
    def gsr_range(self) -> int:
        """0 to 3 for a fixed resistor, 4 for auto-range."""
        return self.setup[3] >> 1 & 7

    @gsr_range.setter
    def gsr_range(self, value: int) -> None:
        self.setup[3] = self.setup[3] & ~0x0E | min(value, 4) << 1


class Hardware(Protocol):
    """What the interpreter asks of the rest of the device."""

    def ticks(self) -> int:
        """Ticks of 1/32768 s since power-on."""
        ...

    def battery_counts(self) -> int:
        """Read the battery's voltage, in counts of the converter."""
        ...


class Interpreter:
    """One device's command processor.

    Parameters
    ----------
    firmware, flash, hardware

    Attributes
    ----------
    sensing
        Samples are taken and sent.
    docked, card_present, led
        Bits of the status; ``led`` is the host's to toggle.
    crc_bytes
        Length of the check of every message.
    """

    def __init__(self, firmware: Firmware, flash: Flash, hardware: Hardware) -> None:
        self._firmware = firmware
        self._flash = flash
        self._hardware = hardware
        self.docked = False
        self.card_present = True
        self._answers = self._handlers()
        self.power_on()

    def power_on(self) -> None:
        """Lose all but the flash."""
        self.led = False
        self._clock_offset: int | None = None
        self.link_lost()

    def link_lost(self) -> None:
        """Stop streaming and return to the messages' original form."""
        self.sensing = False
        self.crc_bytes = 0
        self._ack_before_push = True

    def execute(self, command: Command) -> bytes:
        """Carry out a command; return the whole answer without its check."""
        blocked = self.sensing and command.opcode in _BLOCKED_WHILE_SENSING
        answer = None if blocked else self._answers[command.opcode](command.arguments)
        if answer is not None:
            return ACK + answer
        # Before it had NACKs, the firmware acknowledged and did nothing.
        return NACK if self._firmware.has_nack else ACK

    def pushed_status(self) -> bytes:
        """Return the status as it is sent unasked."""
        return (ACK if self._ack_before_push else b"") + self._status()

    def _handlers(self) -> dict[Opcode, Callable[[bytes], bytes | None]]:
        """Return what each command does; None from it is a refusal."""
        return {
            Opcode.INQUIRY: lambda _: self._inquiry(),
            Opcode.GET_SAMPLING_RATE: lambda _: b"\x04" + _u16(self._flash.divider),
            Opcode.SET_SAMPLING_RATE: self._set_rate,
            Opcode.TOGGLE_LED: lambda _: self._toggle_led(),
            Opcode.START_STREAMING: lambda _: self._start(),
            Opcode.SET_SENSORS: self._set_sensors,
            Opcode.SET_SETUP_BYTES: self._set_setup,
            Opcode.GET_SETUP_BYTES: lambda _: b"\x0f" + self._flash.setup,
            Opcode.STOP_STREAMING: lambda _: self._stop(),
            Opcode.SET_GSR_RANGE: self._set_gsr_range,
            Opcode.GET_GSR_RANGE: lambda _: bytes((0x22, self._flash.gsr_range)),
            Opcode.GET_SHIMMER_VERSION_OLD: lambda _: bytes((0x25, _SHIMMER3)),
            Opcode.GET_ALL_CALIBRATION: lambda _: b"\x2d" + _CALIBRATION,
            Opcode.GET_FIRMWARE_VERSION: lambda _: self._version(),
            Opcode.GET_CHARGE_LED: lambda _: bytes(
                (0x31, battery.led_level(self._hardware.battery_counts()))
            ),
            Opcode.GET_SHIMMER_VERSION: lambda _: bytes((0x25, _SHIMMER3)),
            Opcode.SET_EXPANSION_POWER: self._set_expansion_power,
            Opcode.GET_EXPANSION_POWER: lambda _: bytes((0x5F, self._flash.expansion_power)),
            Opcode.GET_DAUGHTER_CARD: _daughter_card,
            Opcode.GET_STATUS: lambda _: self._status(),
            Opcode.SET_NAME: self._set_name,
            Opcode.GET_NAME: lambda _: _text(0x7A, self._flash.name),
            Opcode.SET_CRC: self._set_crc,
            Opcode.SET_CLOCK: self._set_clock,
            Opcode.GET_CLOCK: lambda _: b"\x90" + self._clock().to_bytes(8, "little"),
            Opcode.GET_BATTERY: lambda _: self._battery(),
            Opcode.TEST_CONNECTION: lambda _: b"",
            Opcode.GET_RADIO_VERSION: lambda _: _text(0xA2, self._firmware.radio),
            Opcode.SET_ACK_PREFIX: self._set_ack_prefix,
        }

    def _inquiry(self) -> bytes:
        channels = channels_of(self._flash.sensors)
        head = b"\x02" + _u16(self._flash.divider) + self._flash.setup
        return head + bytes((len(channels), 1, *channels))

    def _set_rate(self, arguments: bytes) -> bytes:
        self._flash.divider = int.from_bytes(arguments, "little")
        return b""

    def _toggle_led(self) -> bytes:
        self.led = not self.led
        return b""

    def _start(self) -> bytes:
        too_fast = self._flash.divider * MAX_RATE_HZ < TICKS_PER_S
        # Acknowledged all the same, with nothing to follow.
        self.sensing = self.sensing or not (too_fast or not channels_of(self._flash.sensors))
        return b""

    def _stop(self) -> bytes:
        self.sensing = False
        return b""

    def _set_sensors(self, arguments: bytes) -> bytes:
        self._flash.sensors = int.from_bytes(arguments, "little")
        return b""

    def _set_setup(self, arguments: bytes) -> bytes:
        self._flash.setup[:] = arguments
        self._flash.gsr_range = self._flash.gsr_range
        return b""

    def _set_gsr_range(self, arguments: bytes) -> bytes:
        self._flash.gsr_range = arguments[0]
        return b""

    def _version(self) -> bytes:
        major, minor, patch = self._firmware
        return b"\x2f" + _u16(_LOG_AND_STREAM) + _u16(major) + bytes((minor, patch))

    def _set_expansion_power(self, arguments: bytes) -> bytes:
        self._flash.expansion_power = arguments[0]
        return b""

    def _status(self) -> bytes:
        bits = (
            (self.docked, 0),
            (self.sensing, 1),
            (self._clock_offset is not None, 2),
            (self.sensing, 4),
            (self.card_present, 5),
            (self.led, 7),
        )
        return IN_STREAM + bytes((0x71, sum(on << bit for on, bit in bits)))

    def _set_name(self, arguments: bytes) -> bytes | None:
        if arguments[0] > _NAME_LENGTH:
            return None
        self._flash.name = arguments[1:].decode("ascii", "replace")
        return b""

    def _set_crc(self, arguments: bytes) -> bytes | None:
        if arguments[0] > 2:
            return None
        self.crc_bytes = arguments[0]
        return b""

    def _clock(self) -> int:
        return (self._hardware.ticks() + (self._clock_offset or 0)) % (1 << 64)

    def _set_clock(self, arguments: bytes) -> bytes:
        self._clock_offset = int.from_bytes(arguments, "little") - self._hardware.ticks()
        return b""

    def _battery(self) -> bytes:
        counts = self._hardware.battery_counts()
        charger = battery.charger_byte(counts, docked=self.docked)
        return IN_STREAM + b"\x94" + _u16(counts) + bytes((charger,))

    def _set_ack_prefix(self, arguments: bytes) -> bytes:
        self._ack_before_push = bool(arguments[0])
        return b""


def _daughter_card(arguments: bytes) -> bytes | None:
    length, offset = arguments
    if not 0 < length <= _MOST_CARD_BYTES:
        return None
    return bytes((0x65, length)) + _GSR_PLUS_CARD[offset : offset + length]


def _u16(value: int) -> bytes:
    return value.to_bytes(2, "little")


def _text(code: int, text: str) -> bytes:
    data = text.encode("ascii", "replace")
    return bytes((code, len(data))) + data
