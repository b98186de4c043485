"""A virtual device that replays recorded data of a real BioHarness 3."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import date
from importlib.resources import files
from itertools import accumulate
from math import inf
from types import MappingProxyType
from typing import Literal, NamedTuple

from biosensor_gateway.devices.zephyr.simulator.bioharness import BioHarness, Outgoing
from biosensor_gateway.devices.zephyr.simulator.wire import (
    ACK,
    ETX,
    MAX_PAYLOAD,
    MS_PER_DAY,
    NAK,
    REQUESTS,
    STX,
    WAVEFORMS,
    Packet,
    crc8,
    duration_ms,
)
from biosensor_gateway.simulation.faults import FaultKind, Untidiness
from biosensor_gateway.simulation.truth import USUALLY_IMPOSSIBLE, Expected
from biosensor_gateway.simulation.virtual_device import IMPOSSIBLE, Filled
from biosensor_gateway.simulation.wearer import Wearer
from biosensor_gateway.simulation.world import World
from biosensor_gateway.system.clock import Clock

RECORDING_150_S = "zephyr_bh3_2012-09-26_150s"
"""1 479 frames with the arrival times of their reads."""
RECORDING_WITH_GAP = "zephyr_bh3_2012-04-06_with_gap"
"""1 157 frames; a link error lost bytes once and left 39 invalid bytes."""

_LENGTHS = {
    Packet.GENERAL: 53,
    Packet.BREATHING: 32,
    Packet.ECG: 88,
    Packet.LIFESIGN: 0,
    Packet.RR: 45,
    Packet.ACCELERATION: 84,
    Packet.SUMMARY: 71,
}
_PERIODIC = frozenset(REQUESTS.values())
_HANG_UP_AFTER_S = 0.5


class Arrival(NamedTuple):
    """One read of the recording host: time [s] and total number of bytes so far."""

    time: float
    total_bytes: int


def read_timing(text: str) -> list[Arrival]:
    """Return the reads in a timing file, one ``seconds,total`` per line."""
    rows = (line.split(",") for line in text.splitlines() if line)
    return [Arrival(float(time), int(total)) for time, total in rows]


@dataclass(frozen=True)
class RecordedItem:
    """A frame of a recording, or invalid bytes between two frames."""

    data: bytes
    is_frame: bool

    @property
    def packet(self) -> Packet | None:
        """Kind of the frame; None for invalid bytes, answers and unknown message ids."""
        if not self.is_frame or self.is_answer or self.data[1] not in set(Packet):
            return None
        return Packet(self.data[1])

    @property
    def is_answer(self) -> bool:
        """Whether it answers a request of the recording host."""
        return self.is_frame and self.data[1] in REQUESTS

    @property
    def leaves_at_ms(self) -> float:
        """Time of completion by its own timestamp [ms, any origin]; -inf without one."""
        packet = self.packet
        if packet is None or packet is Packet.LIFESIGN:
            return -inf
        year, month, day = int.from_bytes(self.data[4:6], "little"), *self.data[6:8]
        stamp = date(year, month, day).toordinal() * MS_PER_DAY
        stamp += int.from_bytes(self.data[8:12], "little")
        return stamp + (duration_ms(packet) if packet in WAVEFORMS else 0)


def split(data: bytes) -> Iterator[RecordedItem]:
    """Yield a recording's frames and the invalid bytes between them."""
    position = junk_from = 0
    while position < len(data):
        end = _frame_end(data, position)
        if end is None:
            position += 1
            continue
        if junk_from < position:
            yield RecordedItem(data[junk_from:position], is_frame=False)
        yield RecordedItem(data[position:end], is_frame=True)
        position = junk_from = end
    if junk_from < len(data):
        yield RecordedItem(data[junk_from:], is_frame=False)


def _frame_end(data: bytes, start: int) -> int | None:
    """Return the end of the frame that begins at ``start``; None if there is none."""
    if data[start] != STX or start + 5 > len(data):
        return None
    message_id, length = data[start + 1], data[start + 2]
    check_at = start + 3 + length
    if length > MAX_PAYLOAD or check_at + 2 > len(data):
        return None
    fits = _LENGTHS.get(Packet(message_id), length) == length if message_id in set(Packet) else True
    intact = crc8(data[start + 3 : check_at]) == data[check_at]
    return check_at + 2 if fits and intact and data[check_at + 1] in (ETX, ACK, NAK) else None


class RecordedSource:
    """Replays a recording, byte for byte and with its original timing.

    Recorded answers are left out, because the device answers by itself, as are periodic packets
    that the host has not enabled. Lifesigns, events and invalid bytes are always replayed. The
    replay starts when all periodic packets of the recording are enabled, or ``settle_s`` after the
    last change if a host enables only some; it restarts with every connection.

    Parameters
    ----------
    timing
        The recording host's reads. If None, each frame is sent at the time of its last sample
        according to its timestamp, and frames without a timestamp with the previous one.
    on_end
        After the last byte: stay silent, or end the connection once the host has read everything.
    settle_s
        Longest wait for further enables.

    Raises
    ------
    ValueError
        If the recording contains nothing but answers.
    """

    def __init__(
        self,
        data: bytes,
        timing: Sequence[Arrival] | None = None,
        *,
        speed: float = 1.0,
        on_end: Literal["silence", "hang_up"] = "silence",
        settle_s: float = 1.0,
    ) -> None:
        items = list(split(data))
        due = _due_by_reads(items, timing) if timing else _due_by_stamps(items)
        kept = [k for k, item in enumerate(items) if not item.is_answer]
        if not kept:
            raise ValueError("the recording holds nothing to play")
        self._frames = [Outgoing(items[k].data, items[k].packet) for k in kept]
        self._due_s = [due[k] - due[kept[0]] for k in kept]
        self._packets = _PERIODIC & {frame.packet for frame in self._frames}
        self._speed = speed
        self._on_end = on_end
        self._settle_s = settle_s
        self.connection_ended()

    @classmethod
    def shipped(
        cls,
        name: str = RECORDING_150_S,
        *,
        on_end: Literal["silence", "hang_up"] = "silence",
    ) -> RecordedSource:
        """Return one of the recordings that come with the package.

        Parameters
        ----------
        name
            `RECORDING_150_S` or `RECORDING_WITH_GAP`.
        on_end
            As for the class.

        Raises
        ------
        FileNotFoundError
            If there is no recording with that name.
        """
        folder = files("biosensor_gateway").joinpath("devices/zephyr/simulator/recordings")
        timing = folder.joinpath(f"{name}-timing.csv")
        return cls(
            folder.joinpath(f"{name}.dat").read_bytes(),
            read_timing(timing.read_text("ascii")) if timing.is_file() else None,
            on_end=on_end,
        )

    @property
    def speaks_lifesigns(self) -> bool:
        """Whether the replay has started, even if it has ended."""
        return self._began_at is not None

    def power_on(self, clock: Clock) -> None:
        """Do nothing, because a recording waits for its host."""

    def poll(self, now: float, enabled: frozenset[Packet]) -> list[Outgoing]:
        """Return the frames that are due, without disabled ones."""
        self._begin_if_ready(now, enabled)
        if self._began_at is None:
            return []
        played_s = (now - self._began_at) * self._speed
        begin = self._position
        self._position = bisect_right(self._due_s, played_s, lo=begin)
        frames = self._frames[begin : self._position]
        return [f for f in frames if f.packet not in _PERIODIC or f.packet in enabled]

    def next_due(self) -> float:
        """Return when the next frame is sent, the replay starts or the device disconnects."""
        if self._began_at is None:
            return self._changed_at + self._settle_s if self._enabled else inf
        if self._position < len(self._due_s):
            return self._began_at + self._due_s[self._position] / self._speed
        return self._hangs_up_at()

    def hangs_up(self, now: float) -> bool:
        """Whether the recording is over and should end the connection."""
        return self._position == len(self._due_s) and now >= self._hangs_up_at()

    def connection_ended(self) -> None:
        """Rewind."""
        self._began_at: float | None = None
        self._position = 0
        self._enabled: frozenset[Packet] = frozenset()
        self._changed_at = 0.0

    def _begin_if_ready(self, now: float, enabled: frozenset[Packet]) -> None:
        if enabled != self._enabled:
            self._enabled, self._changed_at = enabled, now
        settled = bool(enabled) and now >= self._changed_at + self._settle_s
        if self._began_at is None and (settled or (enabled and enabled >= self._packets)):
            self._began_at = now

    def _hangs_up_at(self) -> float:
        if self._began_at is None or self._on_end == "silence":
            return inf
        return self._began_at + self._due_s[-1] / self._speed + _HANG_UP_AFTER_S


def _due_by_reads(items: Sequence[RecordedItem], timing: Sequence[Arrival]) -> list[float]:
    """Return for each item the time [s] of the read with its last byte."""
    totals = [arrival.total_bytes for arrival in timing]
    ends = accumulate(len(item.data) for item in items)
    return [timing[min(bisect_left(totals, end), len(timing) - 1)].time for end in ends]


def _due_by_stamps(items: Sequence[RecordedItem]) -> list[float]:
    """Return for each item the time [s] of its timestamp, but not before the previous item."""
    times = list(accumulate((item.leaves_at_ms for item in items), max))
    first = next((time for time in times if time > -inf), 0.0)
    return [max(time, first) / 1000 for time in times]


class RecordedZephyr(BioHarness):
    """The recording of 150 s, in a loop.

    Its bytes cannot be changed, so it only has link faults and no truth.

    Parameters
    ----------
    kept
        No effect.
    """

    expected = Expected(
        impossible=dict.fromkeys(
            {*FaultKind, *Untidiness}
            - BioHarness.effects.keys()
            - USUALLY_IMPOSSIBLE.keys()
            - IMPOSSIBLE[BioHarness.link].keys(),
            "it replays a real device's data, which cannot be changed",
        )
    )
    filled = MappingProxyType(
        {
            "hrv": Filled(76, "the recording's first valid value comes at 76 s"),
            "breathing": Filled(1, "the recording's first valid value comes at 1 s"),
            "st": Filled(None, "the recorded device never reports a valid value"),
        }
    )

    @classmethod
    def worn_by(cls, wearer: Wearer, number: int) -> Mapping[str, object]:
        """Return no options, because the recording is the same for every wearer."""
        del wearer, number
        return {}

    def __init__(self, world: World, *, kept: int | None = None) -> None:
        super().__init__(world, RecordedSource.shipped(on_end="hang_up"), kept=kept)
