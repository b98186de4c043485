"""The table of real devices, made by running their captures through the drivers."""

from __future__ import annotations

from functools import cache
from pathlib import Path

from structlog.testing import capture_logs

from biosensor_gateway.captures.file import ENDING, Capture, read
from biosensor_gateway.captures.replay import Report, replay
from tests.docs.catalogue import facts
from tests.docs.tables import table

FILES = Path(__file__).parents[1] / "captures" / "files"


def captures() -> list[Path]:
    """Return the captures that are kept, those of one sensor together."""
    return sorted(FILES.rglob(f"*{ENDING}"))


def worked_with() -> str:
    """Return a row for each capture."""
    rows = [_row(path) for path in captures()]
    columns = ("Sensor", "Model, firmware", "System", "Length", "What was seen", "From")
    return f"\n{table(columns, rows)}\n\n"


@cache
def _row(path: Path) -> tuple[str, ...]:
    capture = read(path)
    header = capture.header
    link = f"[{facts(header.sensor).title}]({header.sensor}.md)"
    device = ", ".join((header.model or "not known", header.firmware or "firmware not known"))
    origin = header.source or f"a capture of {header.recorded}"
    system = header.system.partition(",")[0] or "not known"
    # What a driver says meanwhile is in the report.
    with capture_logs():
        seen = _seen(capture, replay(capture))
    return link, device, system, f"{header.seconds:.0f} s", seen, f"{origin}; {header.licence}"


def _seen(capture: Capture, report: Report) -> str:
    samples = ", ".join(f"`{name}` {each.samples}" for name, each in report.streams.items())
    lost = sum(each.lost for each in report.streams.values())
    jumps = report.reanchors
    parts = [
        f"samples: {samples}" if samples else "",
        f"{report.connections} connections" if report.connections > 1 else "",
        f"{lost} lost" if lost else "nothing lost",
        f"the clock jumped {jumps} times" if jumps else "",
        *report.sentences,
        *report.problems,
        capture.header.note,
    ]
    return "; ".join(each.replace("|", "/") for each in parts if each)
