"""What a fault did to every device, as seen from all sides."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from biosensor_gateway.simulation.truth import Gap
from tests.faults.expectations import (
    CELLS,
    AgentFault,
    Kind,
    device_of,
    gap_of,
    regular_streams,
    source,
    tolerance,
)
from tests.faults.matching import (
    NEAR_S,
    Places,
    UnknownSampleError,
    held_up,
    match,
    missing,
    unread,
)
from tests.faults.recorder import Recorded
from tests.rigs.lab_client import Samples

Cell = tuple[Kind, str]


class Stock(NamedTuple):
    """What the agent said of one device at an LSL time."""

    time_s: float
    status: Mapping[str, Any]

    def counter(self, name: str, data_name: str, counter: str) -> int:
        """One counter of one stream."""
        return self.status["streams"][source(name, data_name)][counter]


class Account(NamedTuple):
    """The books of one regular stream."""

    missing: int  # Samples that there was room for between those that arrived.
    unread: int  # Those of them that the device is known to have sent.
    lost: int  # What the agent counted as lost.


@dataclass
class Episode:
    """Some faults at once, on all devices that can have them."""

    # kinds, begin_s: which, and since when on the LSL clock.
    kinds: tuple[Kind, ...]
    begin_s: float
    # before, after: by sensor.
    before: Mapping[str, Stock]
    after: dict[str, Stock] = field(default_factory=dict[str, Stock])
    # When it ended for each cell; of those without an end, when it had begun.
    end_s: dict[Cell, float] = field(default_factory=dict[Cell, float])
    log: Sequence[Mapping[str, Any]] = ()  # What the agent logged meanwhile.
    seen: set[Cell] = field(default_factory=set[Cell])  # Cells that the agent has noticed.
    # By cell, how long after the end the device was as before.
    recovered_s: dict[Cell, float] = field(default_factory=dict[Cell, float])
    # received, truth: by sensor and data name, from `before` on.
    received: dict[tuple[str, str], Recorded] = field(
        default_factory=dict[tuple[str, str], Recorded]
    )
    truth: dict[tuple[str, str], Samples] = field(default_factory=dict[tuple[str, str], Samples])

    @property
    def cells(self) -> list[Cell]:
        """Which kind hits which sensor."""
        return [(kind, name) for kind, name in CELLS if kind in self.kinds and name in self.before]

    def warnings(self, name: str) -> list[Mapping[str, Any]]:
        """What was said about one device that a person should know."""
        severe = ("warning", "error", "critical")
        own = (record for record in self.log if record.get("sensor") == name)
        return [record for record in own if record["level"] in severe]

    def matched(self, name: str, data_name: str) -> Places:
        """Place of each received sample of one stream in the truth."""
        near_s = NEAR_S
        if data_name in device_of(name).expected.unstamped_s:
            # It has the time at which it was read, and nobody reads while the agent sleeps.
            woke_s = self.end_s.get((AgentFault.ASLEEP, name), self.begin_s)
            near_s += woke_s - self.begin_s
        return match(self.received[name, data_name], self.truth[name, data_name], near_s)

    def account(self, name: str, data_name: str) -> Account:
        """Balance one stream."""
        truth, found = self.truth[name, data_name], self.matched(name, data_name)
        lost = self.counted(name, data_name, "lost")
        return Account(missing(found, truth), unread(found), lost)

    def counted(self, name: str, data_name: str, counter: str) -> int:
        """By how much a counter rose."""
        before, after = (stock[name] for stock in (self.before, self.after))
        return after.counter(name, data_name, counter) - before.counter(name, data_name, counter)

    def imbalance(self, name: str) -> str:
        """Say which stream's books are wrong; nothing if all are right."""
        for data_name in regular_streams(name):
            account = self.account(name, data_name)
            # Those that come together break nothing.
            least, most = _bounds(gap_of(self.kinds[0], name), account)
            allowed = tolerance(self.kinds[0], name, data_name)
            if device_of(name).expected.loss_tolerance.by_arrival:
                allowed += self._held_up(name, data_name)
            if not least - allowed <= account.lost <= most + allowed:
                return f"{name}/{data_name}: {account}"
        return ""

    def _held_up(self, name: str, data_name: str) -> int:
        """Samples that fit into what held packets up beside the gaps of one stream."""
        found = self.matched(name, data_name)
        return held_up(self.received[name, data_name], found, self.truth[name, data_name])

    def is_balanced(self, name: str) -> bool:
        """Whether the books of all streams of a device are right."""
        try:
            return not self.imbalance(name)
        except UnknownSampleError:
            return False


def _bounds(gap: Gap, account: Account) -> tuple[int, int]:
    """The least and the most that was lost, for all that a host can know."""
    match gap:
        case Gap.MEASURED:
            return account.missing, account.missing
        case Gap.STOPPED:
            return account.unread, account.unread
        case Gap.UNKNOWN:
            return max(1, account.unread), account.missing
