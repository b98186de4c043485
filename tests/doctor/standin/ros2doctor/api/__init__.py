"""Stands in for ros2doctor, which cannot be installed where these tests run.

Written from the interface of ros2doctor 0.32 (Jazzy): entry points are loaded, made an
instance of, and asked for ``category`` and ``check`` or ``report``; whatever raises is
left out with a warning; a check has failed if it counted errors, or warnings where these
are included.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator
from importlib.metadata import EntryPoint
from typing import Any

from ros2doctor.api.format import doctor_warn


class Report:
    __slots__ = ["items", "name"]

    def __init__(self, name: str) -> None:
        self.name = name
        self.items: list[tuple[str, object]] = []

    def add_to_report(self, item_name: str, item_info: object) -> None:
        self.items.append((item_name, item_info))


class Result:
    __slots__ = ["error", "warning"]

    def __init__(self) -> None:
        self.error = 0
        self.warning = 0

    def add_error(self) -> None:
        self.error += 1

    def add_warning(self) -> None:
        self.warning += 1


def run_checks(
    points: Iterable[EntryPoint], *, include_warnings: bool = False
) -> tuple[set[str], int, int]:
    """Return the categories that failed, how many checks failed, and how many there were."""
    failed, fail, total = set[str](), 0, 0
    for category, result in _called(points, lambda instance: instance.check()):
        if result.error or (include_warnings and result.warning):
            fail += 1
            failed.add(category)
        total += 1
    return failed, fail, total


def generate_reports(
    points: Iterable[EntryPoint], *, categories: Collection[str] | None = None
) -> list[Report]:
    called = _called(points, lambda instance: instance.report())
    return [report for category, report in called if not categories or category in categories]


def _called(points: Iterable[EntryPoint], call: Callable[[Any], Any]) -> Iterator[tuple[str, Any]]:
    for point in points:
        try:
            instance = point.load()()
            yield instance.category(), call(instance)
        except Exception:  # noqa: BLE001 - as there
            doctor_warn(f"Fail to call {point.name} class functions.")
