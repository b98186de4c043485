"""Computes features of a recording, with the same classes as for live streams."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from biosensor_common.errors import cannot_write
from biosensor_gateway.features.outputs import Feature
from biosensor_gateway.features.runs import Event
from biosensor_gateway.features.sources import (
    FeatureError,
    FeatureReason,
    Source,
    Taken,
    choose,
    is_feature,
    judge,
    left_out,
    stream_info,
)
from biosensor_gateway.features.witnesses import Witnesses
from biosensor_gateway.recording.contents.opening import open_contents, with_true_rates
from biosensor_gateway.recording.contents.stream import Samples, Stream
from biosensor_gateway.recording.participants import compare_file
from biosensor_gateway.recording.xdf import writing
from biosensor_gateway.system.new_file import new_file

SUFFIXES = (".xdf", ".csv")


@dataclass(frozen=True, slots=True)
class Computed:
    """Outcome of computing the features of a recording.

    Attributes
    ----------
    counts
        Number of samples of each stream of a feature, by its LSL name.
    refused
        Why a stream of a suitable type has no features; sentences.
    remarks
        Problems with the stamps of other streams, what could not be read, and whose data may be
        another person's; sentences.
    is_whole
        Whether all of the recording could be read, and is of one agent.
    """

    written: Path
    counts: dict[str, int]
    refused: tuple[str, ...]
    remarks: tuple[str, ...] = ()
    is_whole: bool = True


def compute(path: Path, target: Path) -> Computed:
    """Compute all features of a recording, and write them.

    Parameters
    ----------
    target
        A new XDF file, whose streams have the clocks of their sources, or a new CSV file with a
        row for each value, on the recorder's clock.

    Raises
    ------
    FeatureError
        ``NOTHING``, ``EXISTS`` or ``UNWRITABLE``.
    RecordingError
        If the recording cannot be read.
    """
    with open_contents(path) as contents:
        streams, remarks = with_true_rates(contents.streams)
        pairs, refused = _sources(streams)
        if not any(source.features for _, source in pairs):
            why = "; ".join(refused) or "it has no stream of a type that features are of"
            why += "".join(f"; {each}" for each in remarks) + contents.why_incomplete
            raise FeatureError(FeatureReason.NOTHING, f"no feature of {path}: {why}")
        try:
            with new_file(target, like=path) as file:
                write = _write_csv if target.suffix == ".csv" else _write_xdf
                counts = write(file, pairs, contents.begun, remarks)
        except FileExistsError as error:
            message = f"{target} exists and is not overwritten; give another name with --output"
            raise FeatureError(FeatureReason.EXISTS, message) from error
        except OSError as error:
            message = cannot_write(target, error)
            raise FeatureError(FeatureReason.UNWRITABLE, message) from error
        remarks += [
            f"{each.header.name}: {each.untimed} samples are left out, for their stamps are no "
            "number"
            for each, _ in pairs
            if each.untimed
        ]
        remarks += [
            f"{each.header.name}: {each.clock_error}, so the times of its features are in doubt"
            for each, _ in pairs
            if each.clock_error
        ]
        remarks += [
            f"{each.header.name}: {span.text(contents.begin_s)}"
            for each, _ in pairs
            for span in each.clock.doubtful_spans
        ]
        others = contents.of_other_agents
        mismatch = compare_file(path, (each.header.identity for each in contents.streams))
        remarks += [*others, *([mismatch.sentence] if mismatch else [])]
        if contents.damages:
            remarks.append(f"not all of {path} can be read{contents.why_incomplete}")
        is_whole = not (contents.damages or others)
        return Computed(target, counts, tuple(refused), tuple(remarks), is_whole)


_Pairs = Sequence[tuple[Stream, Source]]


def _sources(streams: Sequence[Stream]) -> tuple[_Pairs, list[str]]:
    found: list[Source] = []
    refused: list[str] = []
    by_header = {id(stream.meaning): stream for stream in streams}
    for stream in streams:
        if is_feature(stream.header.xml):
            continue  # nothing is dropped: features of features are not asked for
        try:
            source = judge(stream.header.name, stream.header.source_id, stream.meaning)
        except FeatureError as error:
            # nothing is dropped: `refused` is printed
            refused.append(str(error))
            continue  # nothing is dropped: as above
        if source is not None:
            found.append(source)
    # A stream without samples gets what is left: which of two has any may depend on the model.
    full = [each for each in found if by_header[id(each.header)].sample_count]
    empty = [each for each in found if not by_header[id(each.header)].sample_count]
    taken: Taken = set()
    chosen = [*choose(full, taken), *choose(empty, taken)]
    kept = {id(each.header): each.features for each in chosen}
    for each in found:
        left = [one for one in each.features if one not in kept.get(id(each.header), ())]
        if why := left_out(each, left, chosen):
            refused.append(why)
    return [(by_header[id(each.header)], each) for each in chosen], refused


def _witnesses(pairs: _Pairs) -> Witnesses:
    """Return the witnesses of all devices, over the whole recording."""
    witnesses: Witnesses = {}
    for stream, source in pairs:
        witness = source.new_witness(keep_s=math.inf)
        if witness is not None and stream.sample_count:
            witnesses[source.key] = witness
            for samples in stream.blocks():
                witness.take(samples.stamps, source.scaled(samples.values))
    return witnesses


def _computed(
    stream: Stream, source: Source, witnesses: Witnesses, remarks: list[str]
) -> Iterator[tuple[Samples, list[Event]]]:
    # A copy, because the computer of a witness would replace the one of the whole recording.
    computer = source.new_computer(dict(witnesses))
    samples: Samples | None = None
    for samples in stream.blocks():
        yield samples, computer.take(samples.stamps, samples.values)
    if samples is not None:
        yield samples, computer.finish()
    if remark := computer.remark():
        remarks.append(remark)


class _Written:
    """A stream of a feature in an XDF file, with the data of its footer."""

    def __init__(self, number: int, stream: Stream, feature: Feature) -> None:
        self.number, self._feature = number, feature
        self.first = self.last = 0.0
        self.sample_count = 0
        self.clock_offsets = stream.clock_offsets

    def chunk(self, events: Sequence[Event]) -> bytes:
        own = [each for each in events if each.feature == self._feature.name]
        if not own:
            return b""  # nothing is dropped: there is nothing
        stamps = np.array([each.stamp for each in own])
        values: NDArray[np.float32] = np.array([each.values for each in own], np.float32)
        self.first = self.first if self.sample_count else float(stamps[0])
        self.last, self.sample_count = float(stamps[-1]), self.sample_count + len(own)
        return writing.samples(self.number, self._feature.stream.format, stamps, values)


def _write_xdf(file: BinaryIO, pairs: _Pairs, begun: str, remarks: list[str]) -> dict[str, int]:
    writing.begin(file, begun, ())
    counts: dict[str, int] = {}
    witnesses, number = _witnesses(pairs), 0
    for stream, source in pairs:
        written: list[_Written] = []
        names: list[str] = []
        for feature in source.features:
            number += 1
            info = stream_info(source, feature)
            names.append(info.name())
            file.write(writing.stream_header(number, info.as_xml()))
            written.append(_Written(number, stream, feature))
            for taken_at, offset in stream.clock_offsets:
                file.write(writing.clock_offset(number, taken_at, offset))
        for _, events in _computed(stream, source, witnesses, remarks):
            file.writelines(each.chunk(events) for each in written)
        for name, each in zip(names, written, strict=True):
            file.write(writing.boundary() + writing.footer(each.number, each))
            counts[name] = each.sample_count
    return counts


def _write_csv(file: BinaryIO, pairs: _Pairs, _begun: str, remarks: list[str]) -> dict[str, int]:
    text = io.TextIOWrapper(file, "utf-8", newline="", write_through=True)
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(["time_s", "stream", "channel", "unit", "value"])
    counts: dict[str, int] = {}
    witnesses = _witnesses(pairs)
    for stream, source in pairs:
        known = {each.name: each for each in source.features}
        names = {name: stream_info(source, each).name() for name, each in known.items()}
        counts |= dict.fromkeys(names.values(), 0)
        for samples, events in _computed(stream, source, witnesses, remarks):
            to_recorder = _clock(stream, samples)
            for event in events:
                name = names[event.feature]
                counts[name] += 1
                time_s = repr(to_recorder(event.stamp))
                channels = known[event.feature].stream.channels
                for channel, value in zip(channels, event.values, strict=True):
                    number = "" if np.isnan(value) else str(np.float32(value))
                    rows.writerow([time_s, name, channel.label, channel.unit, number])
    text.detach()
    return counts


def _clock(stream: Stream, samples: Samples) -> Callable[[float], float]:
    """Return a function that converts stamps near these samples to the recorder's clock."""
    if not stream.clock.is_known:
        return lambda stamp: stamp
    shift = float(samples.times[-1] - samples.stamps[-1])
    if stream.clock.restarts:
        return lambda stamp: stamp + shift
    return lambda stamp: float(stream.clock.to_recorder(np.array([stamp]))[0])
