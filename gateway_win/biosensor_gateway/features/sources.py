"""Judges by its header what can be computed of a stream."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from biosensor_common.quantities import ChannelFormat, ContentType, Unit
from biosensor_common.spec import DeviceIdentity
from biosensor_common.stream_header import StreamHeader
from biosensor_gateway.features import thresholds as at
from biosensor_gateway.features.chains import new_runs
from biosensor_gateway.features.errors import FeatureError, FeatureReason
from biosensor_gateway.features.even_stamps import Steady
from biosensor_gateway.features.outputs import READ_TYPES, Feature, features_of
from biosensor_gateway.features.runs import Array, Event
from biosensor_gateway.features.witnesses import Beside, Motion, Warmth, Witness, Witnesses

_SCALES: dict[str, dict[str, float]] = {
    ContentType.GSR: {"microsiemens": 1, "us": 1, "µs": 1, "μs": 1, "usiemens": 1},
    ContentType.RR: {"s": 1, "seconds": 1, "ms": 1e-3, "milliseconds": 1e-3},
    ContentType.ACCELEROMETER: {
        "g": 1,
        "mg": 1e-3,
        "m/s^2": 1 / at.STANDARD_GRAVITY,
        "m/s2": 1 / at.STANDARD_GRAVITY,
    },
}
"""By type: what a unit, in lower case, is multiplied by. Of other types only ratios matter, so
they need no unit."""

_ANY = "arbitrary"
"""Unit of what is derived of a stream without one."""
_AXES = 3
_NOT_LIT = "ambient"
_SKIN = "skin"
"""The channel that is a temperature of skin, not of a case or of the air."""


@dataclass(frozen=True, slots=True)
class Source:
    """A stream that features are computed of, or that says something of others.

    Attributes
    ----------
    name, source_id
        Of the stream.
    identity
        Of the device; lower-case ROS names also of another program's stream.
    features
        What is computed of it; nothing if it only says something of others.
    columns
        Which of its channels are taken.
    scale
        By which its values are multiplied.
    """

    name: str
    source_id: str
    header: StreamHeader
    identity: DeviceIdentity
    features: tuple[Feature, ...]
    columns: range
    scale: float

    @property
    def key(self) -> tuple[DeviceIdentity, str]:
        """By which it is found as a witness."""
        return self.identity, self.header.content_type

    def new_computer(self, witnesses: Witnesses | None = None) -> Computer:
        """Return what computes its features, from its first sample on.

        Parameters
        ----------
        witnesses
            Of the devices; if it is one, it is added.
        """
        return Computer(self, {} if witnesses is None else witnesses)

    def new_witness(self, keep_s: float = at.MOTION_KEPT_S) -> Witness | None:
        """Return what tells of its samples what they say of other streams, if they do."""
        if self.header.content_type == ContentType.ACCELEROMETER:
            return Motion(self.header.rate, foreign=self.header.foreign, keep_s=keep_s)
        if self.header.content_type == ContentType.TEMPERATURE:
            return Warmth(keep_s)
        return None  # nothing is dropped: it says nothing of others

    def scaled(self, values: object) -> Array:
        """Return those channels that are taken, in the unit that features are computed in."""
        numbers = np.asarray(values, dtype=np.float64).reshape(-1, len(self.header.labels))
        return numbers[:, self.columns.start : self.columns.stop] * self.scale


class Computer:
    """Computes the features of one source, whatever blocks its samples come in."""

    def __init__(self, source: Source, witnesses: Witnesses) -> None:
        header = source.header
        self._source = source
        self._witness = source.new_witness()
        if self._witness is not None:
            witnesses[source.key] = self._witness
        self._beside = Beside(witnesses, *source.key)
        self._wanted = {each.name for each in source.features}
        self._runs = new_runs(header.content_type, header.rate, foreign=header.foreign)
        self._channels = source.columns.stop - source.columns.start
        self._steady = Steady(header.rate) if header.foreign and header.rate > 0 else None

    def take(self, stamps: Array, values: object) -> list[Event]:
        """Take samples in, of shapes (n,) and (n, n_channels), in the source's unit."""
        if not len(stamps):
            return []  # nothing is dropped: there is nothing
        scaled = self._source.scaled(values)
        if self._steady is not None:
            stamps, scaled = self._steady.take(stamps, scaled)
        return self._computed(stamps, scaled)

    def _computed(self, stamps: Array, scaled: Array) -> list[Event]:
        if not len(stamps):
            return []  # nothing is dropped: they wait for even stamps
        if self._witness is not None:
            self._witness.take(stamps, scaled)
        events = self._runs.take(stamps, scaled)
        told = self._beside.take(events, float(stamps[-1]))
        return [each for each in told if each.feature in self._wanted]

    def finish(self) -> list[Event]:
        """Return what would have waited for more samples, or for other streams."""
        found = self._computed(*self._steady.finish(self._channels)) if self._steady else []
        return [*found, *(each for each in self._beside.finish() if each.feature in self._wanted)]

    @property
    def left_out(self) -> int:
        """How many samples were left out for their stamps, and how often these stepped back."""
        return self._runs.left_out + self._runs.steps_back

    @property
    def without_value(self) -> int:
        """How many samples were left out because a value was infinite or too large."""
        return self._runs.without_value

    def remark(self) -> str:
        """Say what was wrong with the stamps so far; empty if nothing was."""
        parts: list[str] = []
        if self._steady is not None and self._steady.pace is not None:
            rate_hz = 1 / self._steady.pace.period_s
            parts.append(f"stamped when it came, so it got even stamps, at {rate_hz:.4g} Hz")
        if count := self._runs.steps_back:
            parts.append(f"its stamps stepped back {_times(count)}, where everything began again")
        if count := self._runs.left_out:
            samples = "1 sample was" if count == 1 else f"{count} samples were"
            parts.append(f"{samples} left out, for stamps that did not follow the ones before")
        return f"{self._source.name}: {'; '.join(parts)}" if parts else ""


def judge(name: str, source_id: str, header: StreamHeader) -> Source | None:
    """Return what can be computed of a stream; None if it is of no type that concerns us.

    Raises
    ------
    FeatureError
        ``UNIT``, ``RATE`` or ``FORMAT``, if it is of such a type and nothing can be computed.
    """
    kind = header.content_type
    if kind not in READ_TYPES or (kind == ContentType.TEMPERATURE and not _is_of_skin(header)):
        return None  # nothing is dropped: no feature is of its type
    columns = _columns(header)
    if header.format is ChannelFormat.STRING or len(header.labels) < columns.stop:
        message = f"stream {name!r} has no {len(columns)} channels of numbers, as {kind} needs"
        raise FeatureError(FeatureReason.FORMAT, message)
    _require_rate(name, header)
    scale = _scale(name, header, columns)
    data_name = _ros_name(header.data_name)
    features = features_of(
        kind, data_name, header.units[columns.start].strip() or _ANY, header.rate
    )
    return Source(name, source_id, header, _identity(header), features, columns, scale)


def _is_of_skin(header: StreamHeader) -> bool:
    """Whether a temperature is that of the skin below a sensor; of others nothing says whose."""
    pairs = zip(header.labels, header.units, strict=True)
    return not header.foreign and (_SKIN, Unit.CELSIUS) in pairs


def _times(count: int) -> str:
    return "once" if count == 1 else f"{count} times"


def _columns(header: StreamHeader) -> range:
    """Return three axes, the skin, or the first channel that is no ambient light."""
    if header.content_type == ContentType.ACCELEROMETER:
        return range(_AXES)
    if header.content_type == ContentType.TEMPERATURE:
        place = header.labels.index(_SKIN)
        return range(place, place + 1)
    lit = (place for place, label in enumerate(header.labels) if label.lower() != _NOT_LIT)
    first = next(lit, 0)
    return range(first, first + 1)


def _require_rate(name: str, header: StreamHeader) -> None:
    if header.content_type not in at.RATES_HZ:
        return  # nothing is dropped: beats have no rate, and a temperature may have any
    low, high = at.RATES_HZ[header.content_type]
    if not low <= header.rate <= high:
        rate = f"{header.rate:g} Hz" if header.rate else "no nominal rate"
        message = (
            f"stream {name!r} has {rate}; features of {header.content_type} need {low:g} to "
            f"{high:g} Hz in its header"
        )
        raise FeatureError(FeatureReason.RATE, message)


def _scale(name: str, header: StreamHeader, columns: range) -> float:
    known = _SCALES.get(header.content_type)
    if known is None:
        return 1.0
    units = {unit.strip() for unit in header.units[columns.start : columns.stop]}
    unit = units.pop()
    if units or not unit:
        what = "several units" if units else "no unit"
        message = f"stream {name!r} has {what}; say in its header what its values are in"
        raise FeatureError(FeatureReason.UNIT, message)
    scale = known.get(unit.lower())
    if scale is None:
        message = (
            f"stream {name!r} is in {unit!r}; features of {header.content_type} need one of "
            f"{', '.join(known)}"
        )
        raise FeatureError(FeatureReason.UNIT, message)
    return scale


def _identity(header: StreamHeader) -> DeviceIdentity:
    if not header.foreign:
        return header.identity
    return DeviceIdentity(_ros_name(header.identity.sensor), header.identity.unit)


def _ros_name(text: str) -> str:
    """Return a lower-case ROS name that a person recognises; others of that name have a unit."""
    words = re.sub(r"[^a-z0-9]+", "_", text.lower()).strip("_")
    name = words if words[:1].isalpha() else f"x{words}"
    return f"{name}_x" if name.endswith(("_chunk", "_stamped")) else name


Taken = set[tuple[DeviceIdentity, str]]
"""Devices, each with the data name of a feature that somebody computes."""


def choose(sources: Iterable[Source], taken: Taken) -> list[Source]:
    """Leave to each source what no better one of its device gives.

    Beats of an ECG are better than those of a pulse, and these than intervals that a device
    tells, which have no quality. The order of the sources does not matter. One that only says
    something of others, and has no features, is left as it is.

    Parameters
    ----------
    taken
        What is computed already; what is chosen is added.
    """
    chosen: list[Source] = []
    for source in sorted(sources, key=_rank):
        left = tuple(
            each
            for each in source.features
            if (source.identity, each.stream.data_name) not in taken
        )
        taken.update((source.identity, each.stream.data_name) for each in left)
        if left or not source.features:
            chosen.append(replace(source, features=left))
    return chosen


def _rank(source: Source) -> tuple[int, str, str]:
    kinds = [kind.value for kind in READ_TYPES]
    return kinds.index(source.header.content_type), source.header.data_name, source.source_id
