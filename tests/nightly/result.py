"""What came of a part: numbers, failed tests, skipped ones."""

from __future__ import annotations

import json
import os
import platform
import xml.etree.ElementTree as ET
from collections import Counter
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

LAST_LINES = 25


def _system() -> str:
    # platform.platform() would start a program.
    return f"{platform.system()} {platform.release()} {platform.machine()}"


@dataclass
class Failure:
    """A test or a command that failed, with the last lines of what it said."""

    test: str
    lines: list[str]


@dataclass
class Result:
    """What came of a part on one version of the project."""

    part: str
    began: str
    seconds: float = 0.0
    # What the part needs and this computer does not have; then nothing was run.
    missing: list[str] = field(default_factory=list[str])
    tests: int = 0  # How many passed or failed.
    failures: list[Failure] = field(default_factory=list[Failure])
    # How many tests were skipped, by reason.
    skipped: dict[str, int] = field(default_factory=dict[str, int])
    system: str = field(default_factory=_system)
    python: str = field(default_factory=platform.python_version)
    processors: int = field(default_factory=lambda: os.cpu_count() or 0)

    @property
    def state(self) -> str:
        """One word."""
        if self.missing:
            return "skipped"
        return "failed" if self.failures else "passed"

    def add_tests(self, junit: Path) -> None:
        """Add the results that pytest has written."""
        skipped, ran = Counter[str](), set[str]()
        for case in ET.parse(junit).getroot().iter("testcase"):
            test = _test_id(case)
            failures = [*case.iter("failure"), *case.iter("error")]
            if (skip := case.find("skipped")) is not None:
                skipped[_reason(skip)] += 1
            # A test whose fixtures fail at the end is there twice, a broken file as no test at all.
            elif case.get("classname"):
                ran.add(test)
            self.failures += [Failure(test, last_lines(each.text)) for each in failures]
        self.tests, self.skipped = len(ran), dict(skipped)

    def write(self, path: Path) -> None:
        """Write it so that a reader finds all of it or nothing."""
        path.parent.mkdir(parents=True, exist_ok=True)
        unfinished = path.with_suffix(".unfinished")
        unfinished.write_text(json.dumps(asdict(self), indent=1), encoding="utf-8")
        unfinished.replace(path)

    @classmethod
    def read(cls, path: Path) -> Result:
        """Read what ``write`` has written."""
        fields: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        fields["failures"] = [Failure(**each) for each in fields["failures"]]
        return cls(**fields)


def last_lines(text: str | None) -> list[str]:
    """Return the last lines that are not empty."""
    return [line for line in (text or "").splitlines() if line.strip()][-LAST_LINES:]


def _test_id(case: ET.Element) -> str:
    name, file = case.get("name", ""), case.get("file")
    return f"{file}::{name}" if case.get("classname") else file or name


def _reason(skip: ET.Element) -> str:
    # Of a whole file that was skipped, the reason is in the text.
    _, skips, reason = (skip.text or "").rpartition("Skipped: ")
    return reason.strip("')\"") if skips else skip.get("message", "")
