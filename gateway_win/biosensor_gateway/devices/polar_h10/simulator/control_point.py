"""The PMD control point: commands in, replies out; no radio and no clock.

A reply is ``F0 op type status more parameters``; one that is longer than a packet goes
on in another with the same first bytes, which ``more`` announces.
"""

from __future__ import annotations

from collections.abc import Iterable

from biosensor_gateway.devices.polar_h10.simulator.pmd import (
    ATT_HEADER_BYTES,
    Measurement,
    Offered,
    OpCode,
    Setting,
    Status,
    decode_choice,
    encode_settings,
)
from biosensor_gateway.devices.polar_h10.simulator.products import Product

_REPLY = 0xF0
_STOPPED_BY_DEVICE = 0x01
_REPLY_HEADER_BYTES = 5
_ONLINE = 0x40
"""Mark of a running measurement in the reply to `OpCode.GET_STATUS`."""
_INVALID = {
    Setting.SAMPLE_RATE: Status.INVALID_SAMPLE_RATE,
    Setting.RESOLUTION: Status.INVALID_RESOLUTION,
    Setting.RANGE: Status.INVALID_RANGE,
    Setting.CHANNELS: Status.INVALID_NUMBER_OF_CHANNELS,
}


class _Refusal(Exception):  # noqa: N818 - a course of the conversation, not an error
    """A command cannot be obeyed."""

    def __init__(self, status: Status) -> None:
        super().__init__(status.name)
        self.status = status


class ControlPoint:
    """One device's measurements, and the conversation that switches them.

    Parameters
    ----------
    running
        Measurements that a former host has left on, with the first settings on offer.
    minimum_mtu
        A start with a smaller ATT MTU is refused with INVALID_MTU.
    short_errors
        Replies of failure end after the status, as some firmware has it.
    announces_stops
        A stop on command is followed by the packet that tells of a stop by the device.

    Attributes
    ----------
    running
        Measurements that are on, with their settings.
    refuses
        Every command fails with INVALID_STATE.
    denied
        Measurements of which every start fails so.
    """

    def __init__(
        self,
        product: Product,
        *,
        running: Iterable[Measurement] = (),
        minimum_mtu: int = 0,
        short_errors: bool = False,
        announces_stops: bool = False,
    ) -> None:
        self.running = {measurement: _first_choice(product, measurement) for measurement in running}
        self.refuses = False
        self.denied: frozenset[Measurement] = frozenset()
        self._product = product
        self._minimum_mtu = max(minimum_mtu, product.minimum_mtu)
        self._short_errors = short_errors
        self._announces_stops = announces_stops

    @property
    def in_sdk_mode(self) -> bool:
        """Whether the wider range of settings is on, and its own evaluation off."""
        return Measurement.SDK_MODE in self.running

    def answer(self, command: bytes, mtu: int) -> tuple[bytes, ...]:
        """Obey or refuse one command that came over a link with this ATT MTU.

        Returns
        -------
        tuple of bytes
            Indications to send, in order.
        """
        head = bytes((_REPLY,)) + command[:2].ljust(2, b"\0")
        try:
            return self._obey(head, command[1:], mtu)
        except _Refusal as refusal:
            reply = head + bytes((refusal.status, 0))
            return (reply[:-1] if self._short_errors else reply,)

    def stop(self, measurements: Iterable[Measurement]) -> bytes:
        """Stop measurements on the device's own account; return the packet that says so."""
        stopped = [one for one in measurements if self.running.pop(one, None) is not None]
        return bytes((_STOPPED_BY_DEVICE, *stopped))

    def _obey(self, head: bytes, body: bytes, mtu: int) -> tuple[bytes, ...]:
        if self.refuses:
            raise _Refusal(Status.INVALID_STATE)
        match head[1]:
            case OpCode.GET_SETTINGS:
                return _reply(head, self._settings(body, sdk_mode=self.in_sdk_mode), mtu)
            case OpCode.START:
                return self._start(head, body, mtu)
            case OpCode.STOP:
                return self._stop(head, body, mtu)
            case OpCode.GET_STATUS:
                states = (one | _ONLINE * (one in self.running) for one in self._product.settings)
                return _reply(head, bytes(states), mtu)
            case OpCode.GET_SDK_SETTINGS if self._product.sdk_settings:
                return _reply(head, self._settings(body, sdk_mode=True), mtu)
            case OpCode.GET_SDK_STATUS if self._product.sdk_settings:
                return _reply(head, bytes((self.in_sdk_mode,)), mtu)
            case OpCode.GET_SDK_SETTINGS | OpCode.GET_SDK_STATUS:
                raise _Refusal(Status.NOT_SUPPORTED)
            case _:
                raise _Refusal(Status.INVALID_OP_CODE)

    def _settings(self, body: bytes, *, sdk_mode: bool) -> bytes:
        measurement = self._measurement(body)
        if len(body) != 1:
            raise _Refusal(Status.INVALID_LENGTH)
        offered = self._product.offered(sdk_mode=sdk_mode)
        if measurement not in offered:
            raise _Refusal(Status.NOT_SUPPORTED)
        return encode_settings(offered[measurement])

    def _start(self, head: bytes, body: bytes, mtu: int) -> tuple[bytes, ...]:
        measurement = self._measurement(body)
        if measurement in self.running:
            raise _Refusal(Status.ALREADY_IN_STATE)
        if measurement in self.denied:
            raise _Refusal(Status.INVALID_STATE)
        if measurement is Measurement.SDK_MODE and self.running:
            raise _Refusal(Status.INVALID_STATE)
        offered = self._product.offered(sdk_mode=self.in_sdk_mode).get(measurement)
        if offered is None and measurement is not Measurement.SDK_MODE:
            raise _Refusal(Status.NOT_SUPPORTED)
        if mtu < self._minimum_mtu:
            raise _Refusal(Status.INVALID_MTU)
        chosen = _choice(offered or {}, body[1:])
        self.running[measurement] = chosen
        return _reply(head, self._product.start_reply(measurement, chosen), mtu)

    def _stop(self, head: bytes, body: bytes, mtu: int) -> tuple[bytes, ...]:
        measurement = self._measurement(body)
        if len(body) != 1:
            raise _Refusal(Status.INVALID_LENGTH)
        if measurement not in self.running:
            raise _Refusal(Status.ALREADY_IN_STATE)
        if measurement is Measurement.SDK_MODE and len(self.running) > 1:
            raise _Refusal(Status.INVALID_STATE)
        announcement = self.stop((measurement,))
        reply = _reply(head, b"", mtu)
        return (*reply, announcement) if self._announces_stops else reply

    def _measurement(self, body: bytes) -> Measurement:
        if not body:
            raise _Refusal(Status.INVALID_LENGTH)
        try:
            measurement = Measurement(body[0])
        except ValueError:
            raise _Refusal(Status.INVALID_MEASUREMENT_TYPE) from None
        if measurement not in self._product.features:
            raise _Refusal(Status.NOT_SUPPORTED)
        return measurement


def _choice(offered: Offered, data: bytes) -> dict[Setting, int]:
    try:
        chosen = decode_choice(data)
    except EOFError:
        raise _Refusal(Status.INVALID_LENGTH) from None
    except ValueError:
        raise _Refusal(Status.INVALID_PARAMETER) from None
    if chosen.keys() != offered.keys():
        raise _Refusal(Status.INVALID_PARAMETER)
    for setting, value in chosen.items():
        if value not in offered[setting]:
            raise _Refusal(_INVALID.get(setting, Status.INVALID_PARAMETER))
    return chosen


def _first_choice(product: Product, measurement: Measurement) -> dict[Setting, int]:
    offered = product.settings.get(measurement, {})
    return {setting: values[0] for setting, values in offered.items()}


def _reply(head: bytes, parameters: bytes, mtu: int) -> tuple[bytes, ...]:
    room = mtu - ATT_HEADER_BYTES - _REPLY_HEADER_BYTES
    parts = [parameters[at : at + room] for at in range(0, len(parameters), room)] or [b""]
    return tuple(
        head + bytes((Status.SUCCESS, number < len(parts))) + part
        for number, part in enumerate(parts, start=1)
    )
