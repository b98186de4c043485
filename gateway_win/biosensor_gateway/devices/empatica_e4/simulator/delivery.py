"""The way from the wristbands to the server's clients, and what befalls lines on it."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field

import numpy as np

from biosensor_gateway.devices.empatica_e4.simulator.conversation import (
    Client,
)
from biosensor_gateway.devices.empatica_e4.simulator.wire import (
    NumberFormat,
    Packet,
    Sample,
)
from biosensor_gateway.devices.empatica_e4.simulator.wristband import Wristband

_STAMP = "1680442024,64479"
_DAMAGED: Sequence[bytes] = tuple(
    line.encode()
    for line in (
        "E4_Bvp 16804420",
        f"E4_Bvp {_STAMP}",
        f"E4_Bvp {_STAMP} NaN",
        f"E4_Bvp {_STAMP} -Infinity",
        f"E4_Acc {_STAMP} 1 2",
        f"E4_Gsr {_STAMP} 0,08 0,09",
        f"E4_Gsr {_STAMP} abc",
        "E4_Bvp 1680442024,64,479 1,0",
        f"E4_Foo {_STAMP} 1,0",
        f"E4_Bvp {_STAMP} 21,54169E4_Bvp 1680442024,66041 20,6037",
        "4479 21,5",
        "hello world",
        "R",
        "R device_frobnicate OK",
        "R device_list x",
        "R device_list 2 | 9ff167 Empatica_E4",
    )
)
_BROKEN_TEXT = b"E4\xff_Bvp 1680442024,6 1\xc3"
_FOREIGN = NumberFormat(decimal_mark="٫", digits="٠١٢٣٤٥٦٧٨٩")  # noqa: RUF001


def damaged_line(rng: np.random.Generator) -> bytes:
    """One damaged line, with its end."""
    kind = int(rng.integers(len(_DAMAGED) + 2))
    if kind < len(_DAMAGED):
        return _DAMAGED[kind] + b"\r\n"
    if kind == len(_DAMAGED):
        return _BROKEN_TEXT + b"\r\n"
    return rng.bytes(48).replace(b"\n", b"\0") + b"\r\n"


@dataclass(frozen=True, slots=True)
class Tear:
    """How a line is torn.

    Attributes
    ----------
    pause_s
        Between the two parts.
    in_line_end
        Between CR and LF, else in the middle.
    """

    pause_s: float
    in_line_end: bool


@dataclass(slots=True)
class Mishaps:
    """What befalls the next lines of data; the numbers count down.

    Attributes
    ----------
    foreign
        Lines have the digits and marks of another script.
    doubled
        Are written twice.
    glued
        Pairs without a line end between them, which nobody can tell apart.
    tears
        One a line.
    cut
        Lines that end in the middle, and the connection with them.
    """

    foreign: bool = False
    doubled: int = 0
    glued: int = 0
    cut: int = 0
    tears: list[Tear] = field(default_factory=list[Tear])


class Delivery:
    """Takes what the wristbands send on to clients.

    Parameters
    ----------
    clients
        Who is connected.
    style
        How numbers are written.
    """

    def __init__(self, clients: Collection[Client], style: NumberFormat) -> None:
        self.mishaps = Mishaps()
        self.style = style
        self._clients = clients
        self._glue_to: bytes = b""

    def deliver(self, wristband: Wristband, packet: Packet) -> None:
        """Send a packet's lines to every client that wants them."""
        wanted = [
            client
            for client in tuple(self._clients)
            if client.wants(wristband.device_id, packet.subscription)
        ]
        if wristband.is_lost or wristband.loses(packet):
            if wanted:
                _note_unsent(wristband, packet.samples)
            return
        for sample in packet.samples:
            stamp_s = wristband.stamps.stamp(sample, packet.arrives_s)
            if wanted:
                style = _FOREIGN if self.mishaps.foreign else self.style
                self._send(wristband, sample, sample.line(stamp_s, style), wanted)

    def _send(
        self, wristband: Wristband, sample: Sample, line: bytes, wanted: list[Client]
    ) -> None:
        takers = [client for client in wanted if client.has_room]
        if not takers or self._is_to_be_spoilt or self.mishaps.foreign:
            # Noted before it is sent: what a client has read is in the truth.
            _note_unsent(wristband, (sample,))
            self._spoil(line, takers)
            return
        name, values = sample.stream.data_name, sample.declared_values
        wristband.truth.sent(name, (sample.measured_s,), (values,))
        if self.mishaps.doubled:
            self.mishaps.doubled -= 1
            line += line
        self._write(line, takers)

    def _write(self, line: bytes, takers: list[Client]) -> None:
        tears = self.mishaps.tears
        # One after the other: while a rest is held back, no other line is torn.
        is_next = bool(tears) and not any(client.is_holding for client in takers)
        tear = tears.pop(0) if is_next else None
        for client in takers:
            if tear is None:
                client.write(line)
            else:
                at = len(line) - 1 if tear.in_line_end else len(line) // 2
                client.write_torn(line, at, tear.pause_s)

    @property
    def _is_to_be_spoilt(self) -> bool:
        return bool(self._glue_to or self.mishaps.glued or self.mishaps.cut)

    def _spoil(self, line: bytes, takers: list[Client]) -> None:
        """Send what is left of a line that comes to nothing."""
        if not takers:
            return
        if self._glue_to:
            line, self._glue_to = self._glue_to + line, b""
        elif self.mishaps.glued:
            self.mishaps.glued -= 1
            self._glue_to = line.rstrip()
            return
        elif self.mishaps.cut:
            self.mishaps.cut -= 1
            line = line[: len(line) // 2]
        for client in takers:
            client.write(line)
            if not line.endswith(b"\n"):
                client.close()


def _note_unsent(wristband: Wristband, samples: tuple[Sample, ...]) -> None:
    for sample in samples:
        wristband.truth.unsent(sample.stream.data_name, 1)
