"""Answers as the belt's firmware does: bytes in, packets out; no radio and no clock."""

from __future__ import annotations

import struct
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from biosensor_gateway.devices.vernier_respiration_belt.simulator import wire
from biosensor_gateway.devices.vernier_respiration_belt.simulator.wire import Command

_ACCEPTED, _NOT_RECOGNISED, _IGNORED = b"\x00", b"\x01", b"\x02"
_DEFAULT_PERIOD_US = wire.TYPICAL_PERIOD_US


class BeltFirmware:
    """The conversation of one connection after the other.

    Parameters
    ----------
    order_code, serial
        What it says of itself.

    Attributes
    ----------
    battery_percent
        Shown in the status.
    refuses
        Every command is ignored, with a status that says so.
    knows_type
        False: samples are of a type that no source names.
    mask
        Channels that are being measured; 0 while it is stopped.
    period_us
        Sampling period.
    starts
        How often measuring was started.
    """

    def __init__(self, order_code: str, serial: str) -> None:
        self._order_code = order_code
        self._serial = serial
        self.battery_percent = 76
        self.refuses = False
        self.knows_type = True
        self.starts = 0
        self.forget()

    def forget(self) -> None:
        """Lose all modes and counters, as with the end of a connection."""
        self.mask = 0
        self.period_us = _DEFAULT_PERIOD_US
        self._counter = 0
        self._auxiliary = 0
        self._heard = bytearray()

    def hear(self, fragment: bytes) -> list[bytes]:
        """Take in a piece of a command; return the packets to answer with."""
        self._heard += fragment
        answers: list[bytes] = []
        while len(self._heard) >= wire.HEADER_BYTES + 1:
            length = self._heard[1]
            if self._heard[0] != wire.COMMAND_HEAD or length < wire.HEADER_BYTES + 1:
                self._heard.clear()
                break
            if len(self._heard) < length:
                break
            command = bytes(self._heard[:length])
            del self._heard[:length]
            if wire.is_sealed(command):
                answers.append(self._answer(command))
        return answers

    def pack(self, rows: NDArray[np.float32]) -> bytes:
        """Make the packet of the next samples of the measured channels."""
        body = wire.measurements(self.mask, self._auxiliary, rows, known=self.knows_type)
        self._auxiliary += len(rows)
        return self._seal(wire.MEASUREMENT_HEAD, body)

    def _answer(self, command: bytes) -> bytes:
        number = command[4]
        payload = _IGNORED if self.refuses else self._carry_out(number, command[5:])
        return self._seal(wire.REPLY_HEAD, bytes((number, command[2])) + payload)

    def _carry_out(self, number: int, arguments: bytes) -> bytes:
        match number:
            case Command.SENSOR_INFO if arguments:
                return wire.sensor_info(arguments[0])
            case Command.SET_PERIOD if len(arguments) >= 10:
                return self._set_period(struct.unpack_from("<Q", arguments, 2)[0])
            case Command.START if len(arguments) >= 6:
                return self._start(struct.unpack_from("<I", arguments, 2)[0])
            case Command.STOP:
                self.mask = 0
                return _ACCEPTED
            case _:
                return self._told().get(number, _NOT_RECOGNISED)

    def _told(self) -> Mapping[int, bytes]:
        """Answers that change nothing."""
        return {
            Command.INIT: _ACCEPTED,
            Command.DISCONNECT: _ACCEPTED,
            Command.GET_STATUS: wire.status(self.battery_percent),
            Command.DEVICE_INFO: wire.device_info(self._order_code, self._serial),
            Command.AVAILABLE: struct.pack("<I", wire.AVAILABLE_MASK),
            Command.DEFAULT: struct.pack("<I", wire.DEFAULT_MASK),
        }

    def _set_period(self, period_us: int) -> bytes:
        is_possible = wire.MIN_PERIOD_US <= period_us <= wire.MAX_PERIOD_US
        if not is_possible or period_us % wire.GRANULARITY_US:
            return _IGNORED
        self.period_us = period_us
        return _ACCEPTED

    def _start(self, mask: int) -> bytes:
        if not mask or mask & ~wire.AVAILABLE_MASK:
            return _IGNORED
        self.mask = mask
        self.starts += 1
        return _ACCEPTED

    def _seal(self, head: int, body: bytes) -> bytes:
        packet = wire.seal(head, self._counter, body)
        self._counter += 1
        return packet
