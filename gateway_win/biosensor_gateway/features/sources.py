"""Determines by a stream's header which features can be computed, and writes their headers."""

from __future__ import annotations

import math
import re
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from enum import Enum, unique

import numpy as np
import pylsl

from biosensor_common import naming
from biosensor_common.errors import GatewayError, SpecError
from biosensor_common.lsl_header import append_children, describe
from biosensor_common.quantities import ChannelFormat, ContentType, Unit, signal_type
from biosensor_common.spec import IRREGULAR, ChannelSpec, DeviceIdentity, DeviceInfo
from biosensor_common.stream_header import BLOCK, PREFIX, Replay, StreamHeader, mark_as_replay
from biosensor_gateway.features import parameters as at
from biosensor_gateway.features.chains import new_runs
from biosensor_gateway.features.even_stamps import EvenStamps
from biosensor_gateway.features.outputs import READ_TYPES, VERSION, Feature, features_of
from biosensor_gateway.features.runs import Array, Event, Runs
from biosensor_gateway.features.witnesses import Beside, Motion, Warmth, Witness, Witnesses


@unique
class FeatureReason(Enum):
    """Why features of a stream or a recording are not computed."""

    UNIT = "unit"
    """A unit is missing or unknown."""
    RATE = "rate"
    """The stream has no nominal rate, or one that is unsuitable for detection."""
    FORMAT = "format"
    """The stream does not have numbers, or has too few channels."""
    NOTHING = "nothing"
    """There is no stream from which features are computed."""
    EXISTS = "exists"
    """A file would be overwritten."""
    UNWRITABLE = "unwritable"
    """The file cannot be written."""


class FeatureError(GatewayError):
    """Features cannot be computed; the message has the stream and the reason."""


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
"""Factor of each unit, in lower case, by type. Features of other types use only ratios, so that
their streams need no unit."""
_ANY = "arbitrary"
"""Unit of features of a stream without a unit."""
_MICRO = str.maketrans({"\N{MICRO SIGN}": "u", "\N{GREEK SMALL LETTER MU}": "u"})
_AXES = 3
_NOT_LIT = "ambient"
_SKIN = "skin"
"""Label of the channel with the temperature of the skin, not of a case or of the air."""


@dataclass(frozen=True, slots=True)
class Source:
    """A stream with features, or one that is a witness for other streams of its device."""

    name: str
    source_id: str
    header: StreamHeader
    # Of the device; with lower-case ROS names also for another program's stream.
    identity: DeviceIdentity
    features: tuple[Feature, ...]  # Features to compute; empty if the stream is only a witness.
    columns: range  # The channels that are used.
    scale: float  # Factor of its values.

    @property
    def key(self) -> tuple[DeviceIdentity, str]:
        """Its key among the witnesses."""
        return self.identity, self.header.content_type

    def new_computer(
        self, witnesses: Witnesses | None = None, *, is_uneven: bool = False
    ) -> Computer:
        """Return a new computation of its features, which begins with its first sample.

        Parameters
        ----------
        witnesses
            Of all devices; if this source is a witness, it is added, and replaces another one with
            its first sample.
        is_uneven
            Whether stamps are known to come in bursts or to overlap.
        """
        return Computer(self, {} if witnesses is None else witnesses, is_uneven=is_uneven)

    def new_witness(self, keep_s: float = at.MOTION_KEPT_S) -> Witness | None:
        """Return a new witness for its samples; None if the source cannot be a witness."""
        if self.header.content_type == ContentType.ACCELEROMETER:
            return Motion(self.header.rate, foreign=self.header.foreign, keep_s=keep_s)
        if self.header.content_type == ContentType.TEMPERATURE:
            return Warmth(keep_s)
        return None  # nothing is dropped: it says nothing of others

    def scaled(self, values: object) -> Array:
        """Return the channels that are used, in the unit of the computations."""
        numbers = np.asarray(values, dtype=np.float64).reshape(-1, len(self.header.labels))
        return numbers[:, self.columns.start : self.columns.stop] * self.scale


class Computer:
    """Computes the features of one source from samples in blocks of any size."""

    def __init__(self, source: Source, witnesses: Witnesses, *, is_uneven: bool = False) -> None:
        header = source.header
        self._is_uneven = is_uneven
        self._source = source
        self._witness, self._witnesses = source.new_witness(), witnesses
        if self._witness is not None:
            witnesses.setdefault(source.key, self._witness)
        self._beside = Beside(witnesses, *source.key)
        self._wanted = {each.name for each in source.features}
        self._rate = header.rate
        self._runs = new_runs(header.content_type, header.rate, foreign=header.foreign)
        self._earlier: list[Runs] = []
        self._channels = source.columns.stop - source.columns.start
        self._even_stamps = None
        if header.foreign and header.rate > 0:
            self._even_stamps = EvenStamps(header.rate, is_uneven=is_uneven)

    def take(self, stamps: Array, values: object) -> list[Event]:
        """Take samples in the source's unit, of shapes (n,) and (n, n_channels)."""
        if not len(stamps):
            return []  # nothing is dropped: there is nothing
        scaled = self._source.scaled(values)
        if self._even_stamps is None:
            return self._computed(stamps, scaled)
        events: list[Event] = []
        while len(stamps):
            # A section at a time, so that results do not depend on how the stream is cut.
            room = self._even_stamps.room
            events += self._computed(*self._even_stamps.take(stamps[:room], scaled[:room]))
            # nothing is dropped: the others were taken above
            stamps, scaled = stamps[room:], scaled[room:]
            if self._is_rate_wrong(self._even_stamps.rate_hz):
                events += self._begin_again(self._even_stamps)
        return events

    def _is_rate_wrong(self, rate_hz: float | None) -> bool:
        return rate_hz is not None and abs(rate_hz / self._rate - 1) > at.WRONG_RATE

    def _begin_again(self, even_stamps: EvenStamps) -> list[Event]:
        """Begin a new run at the rate that the samples have, whatever the header says."""
        header = self._source.header
        self._rate = even_stamps.rate_hz or self._rate
        if not self._is_rate_usable:
            return []  # nothing is dropped: `rate_remark` says that it is of no use
        events = self._computed(*even_stamps.finish(self._channels))
        self._earlier.append(self._runs)
        self._runs = new_runs(header.content_type, self._rate, foreign=header.foreign)
        self._even_stamps = EvenStamps(self._rate, is_uneven=self._is_uneven)
        return events

    def _computed(self, stamps: Array, scaled: Array) -> list[Event]:
        if not len(stamps):
            return []  # nothing is dropped: they wait for even stamps
        if self._witness is not None:
            # Of two accelerometers of a device, one may never send.
            self._witnesses[self._source.key] = self._witness
            self._witness.take(stamps, scaled)
        events = self._runs.take(stamps, scaled)
        ready = self._beside.take(events, float(stamps[-1]))
        return [each for each in ready if each.feature in self._wanted]

    def finish(self) -> list[Event]:
        """Return the events that still wait for more samples, or for other streams."""
        found = (
            self._computed(*self._even_stamps.finish(self._channels)) if self._even_stamps else []
        )
        return [*found, *(each for each in self._beside.finish() if each.feature in self._wanted)]

    @property
    def left_out(self) -> int:
        """Number of samples left out for their stamps, plus the number of steps back."""
        return sum(each.left_out + each.steps_back for each in (*self._earlier, self._runs))

    @property
    def without_value(self) -> int:
        """Number of samples left out because a value was infinite or too large."""
        return sum(each.without_value for each in (*self._earlier, self._runs))

    @property
    def rate_remark(self) -> str:
        """What is wrong with the rate in the header; empty if nothing is."""
        header_hz = self._source.header.rate
        if self._rate == header_hz:
            return ""
        text = f"its header says {header_hz:g} Hz, but its samples come at {self._rate:.4g} Hz"
        if self._is_rate_usable:
            return f"{text}, which is used"
        low, high = at.RATES_HZ[self._source.header.content_type]
        return f"{text}; features need {low:g} to {high:g} Hz"

    @property
    def _is_rate_usable(self) -> bool:
        low, high = at.RATES_HZ.get(self._source.header.content_type, (0.0, math.inf))
        return low <= self._rate <= high

    def remark(self) -> str:
        """Return the problems of the stamps so far; empty if there were none."""
        parts = [self.rate_remark] if self.rate_remark else list[str]()
        if self._even_stamps is not None and self._even_stamps.pace is not None:
            rate_hz = 1 / self._even_stamps.pace.period_s
            parts.append(
                f"stamped on arrival, so it was given even timestamps, at {rate_hz:.4g} Hz"
            )
        runs = (*self._earlier, self._runs)
        if count := sum(each.steps_back for each in runs):
            parts.append(
                f"its timestamps stepped back {_times(count)}, and everything started again there"
            )
        if count := sum(each.left_out for each in runs):
            samples = "1 sample was" if count == 1 else f"{count} samples were"
            parts.append(
                f"{samples} left out, because their timestamps did not follow those before"
            )
        return f"{self._source.name}: {'; '.join(parts)}" if parts else ""


def judge(name: str, source_id: str, header: StreamHeader) -> Source | None:
    """Return the source for a stream; None if features do not need streams of its type.

    Raises
    ------
    FeatureError
        ``UNIT``, ``RATE`` or ``FORMAT`` if a stream of a suitable type cannot be used.
    """
    kind = signal_type(header.content_type)
    if kind != header.content_type:
        header = replace(header, content_type=kind)
    if kind not in READ_TYPES or (kind == ContentType.TEMPERATURE and not _is_of_skin(header)):
        return None  # nothing is dropped: no feature is of its type
    columns = _columns(header)
    if header.format is ChannelFormat.STRING or len(header.labels) < columns.stop:
        message = f"stream {name!r} does not have {len(columns)} numeric channels, as {kind} needs"
        raise FeatureError(FeatureReason.FORMAT, message)
    _require_rate(name, header)
    scale = _scale(name, header, columns)
    data_name = _ros_name(header.data_name)
    features = features_of(kind, data_name, _unit(header.units[columns.start]), header.rate)
    return Source(name, source_id, header, _identity(header), features, columns, scale)


def _unit(text: str) -> str:
    """Convert an arbitrary unit to one for our header, which permits only ASCII."""
    unit = text.strip().translate(_MICRO)
    try:
        return ChannelSpec("any", unit).unit
    except SpecError:
        return _ANY


def _is_of_skin(header: StreamHeader) -> bool:
    """Whether a temperature is that of the skin below a sensor; only our own streams declare it."""
    pairs = zip(header.labels, header.units, strict=True)
    return not header.foreign and (_SKIN, Unit.CELSIUS) in pairs


def _times(count: int) -> str:
    return "once" if count == 1 else f"{count} times"


def _columns(header: StreamHeader) -> range:
    """Return the columns to compute from.

    These are the three axes of an accelerometer, the skin temperature, or else the first channel
    that is not ambient light.
    """
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
        message = f"stream {name!r} has {what}; give the unit of its values in its header"
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
    """Return a recognizable lower-case ROS name; names that are equal differ by their unit."""
    words = re.sub(r"[^a-z0-9]+", "_", text.lower()).strip("_")
    name = words if words[:1].isalpha() else f"x{words}"
    return f"{name}_x" if name.endswith(("_chunk", "_stamped")) else name


Taken = set[tuple[DeviceIdentity, str]]
"""Devices, each with the data name of a feature that is computed already."""


def choose(sources: Iterable[Source], taken: Taken) -> list[Source]:
    """Assign each feature of a device to its best source.

    Beats of an ECG are better than those of a pulse, and these are better than intervals that a
    device reports, which have no quality. The order of the sources does not matter. A source that
    is only a witness is returned unchanged.

    Parameters
    ----------
    taken
        Features that are computed already; the assigned ones are added.
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


def left_out(source: Source, features: Sequence[Feature], owners: Iterable[Source]) -> str:
    """Return why another program's stream does not provide features; empty if that is expected.

    The header of such a stream does not identify its device, so streams with one name and
    source_id are treated as those of one device.

    Parameters
    ----------
    features
        Those that it does not provide.
    """
    names = {each.stream.data_name for each in features}
    for owner in owners:
        theirs = {each.stream.data_name for each in owner.features}
        is_of_device = owner.identity == source.identity and owner.header is not source.header
        if source.header.foreign and is_of_device and (shared := sorted(names & theirs)):
            return (
                f"no {', '.join(shared)} of stream {source.name!r} of type "
                f"{source.header.content_type}: stream {owner.name!r} of type "
                f"{owner.header.content_type} has the source_id {owner.source_id!r} and gives them"
            )
    return ""


def _rank(source: Source) -> tuple[int, str, str]:
    kinds = [kind.value for kind in READ_TYPES]
    return kinds.index(source.header.content_type), source.header.data_name, source.source_id


def is_feature(xml: str) -> bool:
    """Whether a stream's full description says that it was computed here."""
    return f"<{BLOCK}>" in xml


def stream_info(source: Source, feature: Feature) -> pylsl.StreamInfo:
    """Return the header of a feature's stream.

    In addition to the usual header of our streams, it has below ``desc``::

        <features>
          <derived_from>polar_h10-…-ecg</derived_from> <source_id>…</source_id>
          <algorithm>…</algorithm> <version>6</version>
          <window_s>10.0</window_s> <delay_s>0.3</delay_s> <holds_s>5.3</holds_s>
        </features>

    A feature of a replayed stream is marked as a replay.
    """
    stream, replay = feature.stream, source.header.replay
    source_id = naming.source_id(source.identity, stream.data_name)
    desc = describe(stream, source.identity, DeviceInfo(model=feature.algorithm))
    _add_origin(desc, source, feature)
    if replay is not None:
        mark_as_replay(
            desc, Replay(replay.file, source_id, IRREGULAR, replay.speed, replay.start_s)
        )
        # The hash of the recording, taken from the replayed stream's source_id.
        played = source.source_id.removeprefix(PREFIX).partition(":")[0]
        source_id = f"{PREFIX}{played}:{source_id}"
    info = pylsl.StreamInfo(
        naming.lsl_name(source.identity, stream.data_name),
        stream.content_type.value,
        len(stream.channels),
        IRREGULAR,
        stream.format.value,
        source_id,
    )
    append_children(info.desc(), desc)
    return info


def _add_origin(desc: ET.Element, source: Source, feature: Feature) -> None:
    block = ET.SubElement(desc, BLOCK)
    for name, text in (
        ("derived_from", source.name),
        ("source_id", source.source_id),
        ("algorithm", feature.algorithm),
        ("version", VERSION),
        ("window_s", repr(float(feature.window_s))),
        ("delay_s", repr(float(feature.delay_s))),
        ("holds_s", repr(float(feature.holds_s))),
    ):
        ET.SubElement(block, name).text = text
