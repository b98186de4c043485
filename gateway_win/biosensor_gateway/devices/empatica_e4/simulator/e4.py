"""A virtual E4 streaming server with wristbands.

::

    with World() as world, SimulatedE4(world, seed=1) as server:
        server.settings  # host, port, device
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import cycle
from math import inf
from types import MappingProxyType
from typing import Any, Unpack

import numpy as np

from biosensor_gateway.devices.empatica_e4.simulator.conversation import (
    Client,
    Commands,
    Listener,
    Manners,
)
from biosensor_gateway.devices.empatica_e4.simulator.wire import (
    NumberFormat,
    Packet,
    Sample,
    WallClock,
)
from biosensor_gateway.devices.empatica_e4.simulator.wristband import Timing, Wristband
from biosensor_gateway.simulation.faults import (
    Effect,
    FaultKind,
    Untidiness,
    flag,
    glued,
    lasting,
    level,
    on_part,
)
from biosensor_gateway.simulation.tcp_port import LOOPBACK
from biosensor_gateway.simulation.truth import ONE_RATE, Expected, LossTolerance, Truth
from biosensor_gateway.simulation.virtual_device import (
    Filled,
    Link,
    Specimen,
    SpecimenOptions,
    VirtualDevice,
)
from biosensor_gateway.simulation.world import Oscillator, World

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
    """Return one damaged line with its line end."""
    kind = int(rng.integers(len(_DAMAGED) + 2))
    if kind < len(_DAMAGED):
        return _DAMAGED[kind] + b"\r\n"
    if kind == len(_DAMAGED):
        return _BROKEN_TEXT + b"\r\n"
    return rng.bytes(48).replace(b"\n", b"\0") + b"\r\n"


@dataclass(frozen=True, slots=True)
class Tear:
    """How a line is torn."""

    pause_s: float  # Pause between the two parts.
    in_line_end: bool  # Whether it is torn between CR and LF, else in the middle.


@dataclass(slots=True)
class Mishaps:
    """Faults of the next data lines; the numbers count down."""

    foreign: bool = False  # Number of lines with digits and marks of another script.
    doubled: int = 0
    # Number of line pairs without a line end between them, which cannot be separated.
    glued: int = 0
    cut: int = 0  # Number of lines that end in the middle, together with the connection.
    tears: list[Tear] = field(default_factory=list[Tear])


class Delivery:
    """Sends the wristbands' data to clients."""

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
        if wristband.is_lost:
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
            # Recorded before sending, so that everything a client has read is in the truth.
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
        # One at a time: while the rest of a line is held back, no other line is torn.
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
        """Send a line in damaged form."""
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


EXPECTED = Expected(
    without_contact=("gsr",),
    by_agent=frozenset({"quality"}),
    impossible={
        FaultKind.REPEAT: "each interval comes with the time of its beat",
        Untidiness.RATE: ONE_RATE,
    },
    # Losses are estimated as a time, to 0.05 s, and some samples arrive in groups of six.
    loss_tolerance=LossTolerance(always={"bvp": 4, "acc": 2, "gsr": 6, "st": 6}),
)

_DENIABLE = ("bvp", "acc", "gsr", "tmp")


class SimulatedE4(VirtualDevice):
    """An E4 streaming server, on its own port, with one or more wristbands.

    Faults affect the first wristband.

    Parameters
    ----------
    device_id
        Id of the first wristband.
    others
        Ids of further wristbands; each has a wearer with a different seed.
    automatic
        Whether the server connects wristbands by itself, like one with a window by default; if
        False, clients must do it, as with a server without a window.
    allowed
        Whether the first wristband is registered to the owner of the server's key.
    style
        Number format of the Windows locale; a restart changes the decimal mark.
    timing
        When samples leave the wristbands; their jitter is ``jitter_s``.
    **specimen
        As for every virtual device: see `Specimen`. The drift applies to each wristband's
        oscillator.
    """

    sensor = "empatica_e4"
    link = Link.TCP
    expected = EXPECTED
    filled = MappingProxyType(
        {
            "hr": Filled(8, "the server sends it six seconds late"),
            "ibi": Filled(8, "the server sends it six seconds late"),
            "bat": Filled(11, "the server sends it every ten seconds"),
            "tag": Filled(None, "nobody presses the virtual wristband's button"),
            "gsr": Filled(2, "the server sends it in bursts"),
            "st": Filled(2, "the server sends it in bursts"),
        }
    )

    def __init__(
        self,
        world: World,
        *,
        device_id: str = "9ff167",
        others: Sequence[str] = (),
        automatic: bool = True,
        allowed: bool = True,
        style: NumberFormat | None = None,
        timing: Timing | None = None,
        **specimen: Unpack[SpecimenOptions],
    ) -> None:
        super().__init__(world, **specimen)
        timing = replace(timing or Timing(), jitter_s=self.specimen.jitter_s)
        self._is_automatic = automatic
        self._is_up = self._is_over = False
        self._rng = np.random.default_rng((self.specimen.seed, 0x6A))
        self._wristbands: dict[str, Wristband] = {}
        self._manners = Manners()
        self._commands = Commands(self._wristbands, self._manners, self._connect)
        self._listener = Listener(self._commands.hear)
        self._delivery = Delivery(self._listener.clients, style or NumberFormat())
        for number, each in enumerate((device_id, *others)):
            own = _further(self.specimen, number) if number else self.specimen
            self._wristbands[each.lower()] = Wristband(
                each,
                own,
                timing,
                is_allowed=allowed or number > 0,
                truth=Truth(own.kept) if number else self.truth,
                deliver=self._delivery.deliver,
            )
        self._first = self._wristbands[device_id.lower()]
        self._to_deny = cycle(_DENIABLE)

    @property
    def settings(self) -> Mapping[str, Any]:
        """Host, port and wristband id."""
        return self.settings_of(self._first.device_id)

    def settings_of(self, device_id: str) -> Mapping[str, Any]:
        """Return the settings for another wristband."""
        return {"host": LOOPBACK, "port": self._listener.port, "device": device_id}

    def truth_of(self, device_id: str) -> Truth:
        """Return what one wristband measured and sent."""
        return self._wristbands[device_id.lower()].truth

    async def _start(self) -> None:
        self._clock = WallClock(self.world.clock)
        for wristband in self._wristbands.values():
            wristband.begin(self._clock)
        self._come_up()

    async def _stop(self) -> None:
        # Cancels a restart in progress.
        self._is_over, self._is_up = True, False
        self._disconnect_all()
        await self._listener.stop()

    def _come_up(self) -> None:
        """Start the server's process."""
        if self._is_over:
            return
        self._is_up = True
        self._listener.open()
        self._attend(self._wristbands.values())

    def _go_down(self) -> None:
        """End the process; the next one runs with another locale."""
        self._is_up = False
        self._listener.shut()
        self._disconnect_all()
        self._delivery.style = self._delivery.style.with_other_mark()

    def _attend(self, wristbands: Iterable[Wristband]) -> None:
        """Connect available wristbands, if the server does that by itself."""
        if not (self._is_automatic and self._is_up):
            return
        for each in wristbands:
            if each.is_advertising and each.is_allowed and not each.is_left_alone:
                self._connect(each)

    def _connect(self, wristband: Wristband, patience_s: float = inf) -> None:
        was_lost = wristband.is_lost
        wristband.connect(patience_s)
        if was_lost:
            self._tell(wristband, f"R connection re-established to device {wristband.device_id}")

    def _disconnect_all(self) -> None:
        for wristband in self._wristbands.values():
            wristband.disconnect()

    def _tell(self, wristband: Wristband, event: str) -> None:
        for client in tuple(self._listener.clients):
            if client.bound_to == wristband.device_id:
                client.write(f"{event}\n".encode())

    def _send_raw(self, data: bytes) -> None:
        for client in tuple(self._listener.clients):
            client.write(data)

    def _break_links(self) -> None:
        self._listener.reset_all()

    def _lose(self) -> None:
        """Move the first wristband out of range, and notify its clients."""
        was_connected = self._first.is_connected
        self._first.lose()
        if was_connected:
            self._tell(self._first, f"R connection lost to device {self._first.device_id}")

    def _come_back(self) -> None:
        self._first.come_back()
        self._attend((self._first,))

    def _babble(self, lines: float) -> None:
        for _ in range(round(lines)):
            self._send_raw(damaged_line(self._rng))

    def _send_unknown(self, lines: float) -> None:
        for _ in range(round(lines)):
            self._send_raw(b"E4_Unknown 1700000000.5 1.0\r\n")

    def _deny(self) -> None:
        """Refuse subscriptions to one signal, a different one each time."""
        self._manners.refused_streams.add(next(self._to_deny))
        self._break_links()

    def _give(self) -> None:
        self._manners.refused_streams.clear()

    def _forget(self, _: float) -> None:
        """Forget all subscriptions but keep the bindings."""
        for client in self._listener.clients:
            client.subscriptions.clear()

    effects = MappingProxyType(
        {
            FaultKind.DROP: lasting(_lose, _come_back),
            FaultKind.GARBAGE: Effect(_babble),
            FaultKind.REFUSE: flag("_manners.refuses_binding", then=_break_links),
            FaultKind.DENY: lasting(_deny, _give),
            Untidiness.GLUED: glued("_listener"),
            Untidiness.STRAY: Effect(_send_unknown),
            FaultKind.LATE: level("_manners.late_s", 0.0, then=_break_links),
            FaultKind.FORGET: Effect(_forget),
            FaultKind.UNREADABLE: flag("_delivery.mishaps.foreign"),
            FaultKind.LOW_BATTERY: level(
                "_first.signals.battery", read=lambda percent: percent / 100
            ),
            FaultKind.OFF_BODY: flag("_first.signals.is_worn", False),
            **on_part("_first.oscillator", {FaultKind.DRIFT: Effect(Oscillator.set_drift)}),
            FaultKind.RESTART: lasting(_go_down, _come_up),
            **on_part("_listener", {FaultKind.STALL: lasting(Listener.stall, Listener.resume)}),
        }
    )


def _further(first: Specimen, number: int) -> Specimen:
    """Return the specimen of a further wristband, with a different wearer."""
    return Specimen(
        seed=first.seed + number,
        drift_ppm=first.drift_ppm,
        jitter_s=first.jitter_s,
        kept=first.kept,
    )
