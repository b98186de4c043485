"""Versions of Cortex: which columns a stream has in which."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, auto

from biosensor_gateway.devices.emotiv_insight.simulator.models import Model

_BANDS = ("theta", "alpha", "betaL", "betaH", "gamma")

Columns = list[str | list[str]]


class Metrics(Enum):
    """Layout of the performance metrics."""

    SEVEN = auto()
    """Seven numbers, without ``isActive``."""
    FOCUS = auto()
    ATTENTION_FIRST = auto()
    ATTENTION_LAST = auto()


@dataclass(frozen=True, slots=True)
class Release:
    """One version of Cortex.

    Parameters
    ----------
    version
        As ``getCortexInfo`` has it, such as ``4.8.32``.
    metrics
        Layout of ``met``; None = the one that this version usually has.
    """

    version: str
    metrics: Metrics | None = None

    @property
    def must_scan(self) -> bool:
        """Tell whether headsets are looked for only when a client asks for it."""
        return self._at_least(3, 7)

    @property
    def names_metrics(self) -> bool:
        """Tell whether the session object lists the performance metrics."""
        return self._at_least(3)

    @property
    def streams(self) -> tuple[str, ...]:
        """Streams that can be had."""
        return ("eeg", "mot", "pow", "met", "dev", *(("eq",) if self._at_least(2, 7) else ()))

    def columns(self, stream: str, model: Model) -> Columns:
        """Columns of a stream, as the reply to a subscription lists them."""
        match stream:
            case "eeg":
                markers = ("MARKERS",) if self._at_least(2, 1) else ()
                lead = ("COUNTER", "INTERPOLATED")
                return [*lead, *model.electrodes, "RAW_CQ", "MARKER_HARDWARE", *markers]
            case "mot":
                return ["COUNTER_MEMS", "INTERPOLATED_MEMS", *model.motion_sensors]
            case "pow":
                return [f"{name}/{band}" for name in model.electrodes for band in _BANDS]
            case "met":
                return self._metric_columns()
            case "dev":
                return self._device_columns(model)
            case _:
                return ["batteryPercent", "overall", "sampleRateQuality", *model.electrodes]

    def _device_columns(self, model: Model) -> Columns:
        if self._at_least(2, 7):
            return ["Battery", "Signal", [*model.electrodes, "OVERALL"], "BatteryPercent"]
        return ["Battery", "Signal", [*model.electrodes]]

    def _metric_columns(self) -> Columns:
        six = ["eng", "exc", "lex", "str", "rel", "int"]
        match self.metrics or self._usual_metrics():
            case Metrics.SEVEN:
                return [*six, "foc"]
            case Metrics.FOCUS:
                return _with_activity([*six, "foc"])
            case Metrics.ATTENTION_FIRST:
                return _with_activity(["attention", *six])
            case Metrics.ATTENTION_LAST:
                return _with_activity([*six, "attention"])

    def _usual_metrics(self) -> Metrics:
        if self._at_least(4):
            return Metrics.ATTENTION_FIRST
        if self._at_least(3):
            return Metrics.ATTENTION_LAST
        return Metrics.FOCUS if self._at_least(2, 2, 1) else Metrics.SEVEN

    def _at_least(self, *number: int) -> bool:
        return tuple(int(part) for part in self.version.split(".")) >= number


def _with_activity(names: list[str]) -> Columns:
    columns: Columns = []
    for name in names:
        # The long-term excitement is the one that is never inactive.
        columns += [name] if name == "lex" else [f"{name}.isActive", name]
    return columns
