"""One table for the test report: sensor x fault x time to recover."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

NAME = "fault-table"
LEGEND = (
    "Seconds from the end of a fault to the first new sample of a stream that never pauses. "
    "Late answers: from the break that comes with them. Off-body: until the device says that it "
    "is worn again. Forgets: from when it forgot what was switched on. Asleep: from when the "
    "agent ran again. What has no end (garbage, low battery, drift) is counted from its start. "
    "Blank: the device cannot have it."
)
FAILED = "never"


@dataclass(frozen=True, slots=True)
class Row:
    """One cell, with the books of each regular stream; None for what never recovered."""

    sensor: str
    fault: str
    recovered_s: float | None
    accounts: dict[str, dict[str, int]]


class FaultTable:
    """Collects the rows; what is added again replaces what was there."""

    def __init__(self) -> None:
        self._rows: dict[tuple[str, str], Row] = {}

    def __bool__(self) -> bool:
        return bool(self._rows)

    def add(self, row: Row) -> None:
        self._rows[row.sensor, row.fault] = row

    def rows(self) -> list[dict[str, Any]]:
        """All rows, as JSON can say them."""
        return [asdict(row) for row in self._rows.values()]

    def take(self, rows: Iterable[dict[str, Any]]) -> None:
        """Add what another table's :meth:`rows` said."""
        for row in rows:
            self.add(Row(**row))

    def markdown(self) -> str:
        """A table with one line a sensor."""
        sensors = list(dict.fromkeys(sensor for sensor, _ in self._rows))
        faults = list(dict.fromkeys(fault for _, fault in self._rows))
        lines = [["sensor", *faults], ["---", *("---:" for _ in faults)]]
        lines += [[sensor, *(self._cell(sensor, fault) for fault in faults)] for sensor in sensors]
        widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
        padded = [
            [cell.ljust(width) for cell, width in zip(line, widths, strict=True)] for line in lines
        ]
        return "\n".join(f"| {' | '.join(line)} |" for line in padded)

    def write(self, folder: Path) -> None:
        """Write it as markdown, and with all figures as JSON."""
        folder.mkdir(parents=True, exist_ok=True)
        text = f"{LEGEND}\n\n{self.markdown()}\n"
        (folder / f"{NAME}.md").write_text(text, encoding="utf-8")
        text = json.dumps(self.rows(), indent=1)
        (folder / f"{NAME}.json").write_text(text, encoding="utf-8")

    def _cell(self, sensor: str, fault: str) -> str:
        row = self._rows.get((sensor, fault))
        if row is None:
            return ""
        return FAILED if row.recovered_s is None else f"{row.recovered_s:.1f}"
