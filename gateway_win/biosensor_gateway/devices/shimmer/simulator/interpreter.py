"""Executes commands like the firmware: changes the state and returns answers.

It has no I/O: commands come in, messages without checksum go out; time and battery are provided by
`Hardware`.
"""

from __future__ import annotations

from collections.abc import Callable

from biosensor_gateway.devices.shimmer.simulator import wire
from biosensor_gateway.devices.shimmer.simulator.wire import (
    ACK,
    BMP180,
    BMP280,
    IN_STREAM,
    NACK,
    REGISTERS,
    SHIMMER3R,
    TICKS_PER_S,
    Command,
    Firmware,
    Flash,
    Memory,
    Opcode,
    channels_of,
)

MAX_RATE_HZ = 4096
_NAME_LENGTH = 12
_MOST_CARD_BYTES = 128
_LOG_AND_STREAM = 3
_MOST_EXG_BYTES = 10
_COEFFICIENT_BYTES = {BMP180: 22, BMP280: 24}
_NONE = b"\x01"
_SHARED_CLOCK = 0x08
_EXG_UNIFIED, _FIRST_WITH_SHARED_CLOCK = 47, 4
_BLOCKED_WHILE_SENSING = frozenset(
    {
        Opcode.SET_SAMPLING_RATE,
        Opcode.SET_SENSORS,
        Opcode.SET_SETUP_BYTES,
        Opcode.SET_GSR_RANGE,
        Opcode.SET_EXPANSION_POWER,
        Opcode.SET_EXG_REGISTERS,
        Opcode.SET_NAME,
    }
)


class Interpreter:
    """One device's command processor.

    Attributes
    ----------
    sensing
        Whether samples are measured and sent.
    docked, card_present, led
        Bits of the status; the host can toggle ``led``.
    crc_bytes
        Length of the checksum of every message.
    """

    def __init__(
        self,
        firmware: Firmware,
        flash: Flash,
        ticks: Callable[[], int],
        battery_counts: Callable[[], int],
        memory: Memory | None = None,
    ) -> None:
        self._memory = memory or Memory()
        self._firmware = firmware
        self._flash = flash
        # Returns ticks of 1/32768 s since power-on, and the battery's voltage in ADC counts.
        self._ticks, self._battery_counts = ticks, battery_counts
        self.docked = False
        self.card_present = True
        self._answers = self._handlers()
        self.power_on()

    def power_on(self) -> None:
        """Reset everything except the flash."""
        self.led = False
        self._clock_offset: int | None = None
        self.link_lost()

    def link_lost(self) -> None:
        """Stop streaming and reset the message format."""
        self.sensing = False
        self.crc_bytes = 0
        self._ack_before_push = True

    def execute(self, command: Command) -> bytes:
        """Execute a command; return the complete answer without its checksum."""
        blocked = self.sensing and command.opcode in _BLOCKED_WHILE_SENSING
        answer = None if blocked else self._answers[command.opcode](command.arguments)
        if answer is not None:
            return ACK + answer
        # Firmware without NACK acknowledges the command but ignores it.
        return NACK if self._firmware.has_nack else ACK

    def pushed_status(self) -> bytes:
        """Return an unrequested status."""
        return (ACK if self._ack_before_push else b"") + self._status()

    def _handlers(self) -> dict[Opcode, Callable[[bytes], bytes | None]]:
        """Return the handlers of commands; they return None for a refusal."""
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
            Opcode.GET_SHIMMER_VERSION_OLD: lambda _: self._version_of_hardware(),
            Opcode.GET_ALL_CALIBRATION: lambda _: b"\x2d" + self._memory.calibration,
            Opcode.GET_BMP180_COEFFICIENTS: lambda _: b"\x58" + self._coefficients(BMP180),
            Opcode.GET_BMP280_COEFFICIENTS: lambda _: b"\x9f" + self._coefficients(BMP280),
            Opcode.GET_PRESSURE_COEFFICIENTS: lambda _: self._pressure(),
            Opcode.SET_EXG_REGISTERS: self._set_exg,
            Opcode.GET_EXG_REGISTERS: self._get_exg,
            Opcode.GET_FIRMWARE_VERSION: lambda _: self._version(),
            Opcode.GET_CHARGE_LED: lambda _: bytes((0x31, wire.led_level(self._battery_counts()))),
            Opcode.GET_SHIMMER_VERSION: lambda _: self._version_of_hardware(),
            Opcode.SET_EXPANSION_POWER: self._set_expansion_power,
            Opcode.GET_EXPANSION_POWER: lambda _: bytes((0x5F, self._flash.expansion_power)),
            Opcode.GET_DAUGHTER_CARD: self._daughter_card,
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
        channels = channels_of(self._flash.sensors, self._memory.model)
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
        # Acknowledged even if no data will follow.
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

    def _version_of_hardware(self) -> bytes:
        return bytes((0x25, self._memory.model.hardware))

    def _coefficients(self, chip: int) -> bytes:
        if chip == self._memory.pressure_chip:
            return self._memory.pressure_coefficients
        return _NONE * _COEFFICIENT_BYTES[chip]

    def _pressure(self) -> bytes:
        data = bytes((self._memory.pressure_chip,)) + self._memory.pressure_coefficients
        return bytes((0xA6, len(data))) + data

    def _set_exg(self, arguments: bytes) -> bytes:
        chip, start, length = arguments[:3]
        if chip < 2 and start < REGISTERS and length <= _MOST_EXG_BYTES:
            registers = self._flash.exg[chip]
            registers[start : start + length] = arguments[3:]
            board, revision, _ = self._memory.card
            if chip == 0 and board == _EXG_UNIFIED and revision >= _FIRST_WITH_SHARED_CLOCK:
                registers[1] |= _SHARED_CLOCK
        return b""

    def _get_exg(self, arguments: bytes) -> bytes:
        chip, start, length = arguments
        if chip >= 2 or start >= REGISTERS or length > _MOST_EXG_BYTES:
            return bytes((0x62, 0))
        return bytes((0x62, length)) + bytes(self._flash.exg[chip][start : start + length])

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
        # A second byte contains the state of the USB plug.
        more = bytes(1) if self._has_two_status_bytes else b""
        return IN_STREAM + bytes((0x71, sum(on << bit for on, bit in bits))) + more

    @property
    def _has_two_status_bytes(self) -> bool:
        return self._memory.model is SHIMMER3R and self._firmware >= (1, 0, 24)

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
        return (self._ticks() + (self._clock_offset or 0)) % (1 << 64)

    def _set_clock(self, arguments: bytes) -> bytes:
        self._clock_offset = int.from_bytes(arguments, "little") - self._ticks()
        return b""

    def _battery(self) -> bytes:
        counts = self._battery_counts()
        charger = wire.charger_byte(counts, docked=self.docked)
        return IN_STREAM + b"\x94" + _u16(counts) + bytes((charger,))

    def _daughter_card(self, arguments: bytes) -> bytes | None:
        length, offset = arguments
        if not 0 < length <= _MOST_CARD_BYTES:
            return None
        return bytes((0x65, length)) + self._memory.page[offset : offset + length]

    def _set_ack_prefix(self, arguments: bytes) -> bytes:
        self._ack_before_push = bool(arguments[0])
        return b""


def _u16(value: int) -> bytes:
    return value.to_bytes(2, "little")


def _text(code: int, text: str) -> bytes:
    data = text.encode("ascii", "replace")
    return bytes((code, len(data))) + data
