"""Computes features of a recording, with the same classes as for live streams."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain
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
from biosensor_gateway.recording.contents.contents import (
    Contents,
    has_uneven_stamps,
    one_rate_each,
    open_ended,
    with_steady_stamps,
    with_true_rates,
)
from biosensor_gateway.recording.contents.stream import Samples, Stream
from biosensor_gateway.recording.participants import compare_file
from biosensor_gateway.recording.xdf import chunks
from biosensor_gateway.recording.xdf.pace import stray_text
from biosensor_gateway.recording.xdf.recording import repeated_text
from biosensor_gateway.system.new_file import new_file

SUFFIXES = (".xdf", ".csv")


@dataclass(frozen=True, slots=True)
class Computed:
    """Outcome of computing the features of a recording."""

    written: Path
    counts: dict[str, int]  # Number of samples of each stream of a feature, by its LSL name.
    refused: tuple[str, ...]  # Why a stream of a suitable type has no features; sentences.
    # Problems with the stamps of other streams, what could not be read, and whose data may be
    # another person's; sentences.
    remarks: tuple[str, ...] = ()
    # Whether all of the recording could be read, is of one agent, and has no stream twice at the
    # same time.
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
    ConfigError
        ``IN_USE`` if it is still being recorded.
    RecordingError
        If the recording cannot be read.
    """
    with open_ended(path) as contents:
        rated, remarks = with_true_rates(contents.streams)
        pairs, refused, doubled = _sources(_in_parts(one_rate_each(contents.streams), rated))
        if not any(source.features for _, source in pairs):
            why = "; ".join(refused) or "it has no stream of a type for which there are features"
            why += "".join(f"; {each}" for each in remarks) + contents.why_incomplete
            raise FeatureError(FeatureReason.NOTHING, f"no features from {path}: {why}")
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
        read = [each for parts, _ in pairs for each in parts]
        remarks += _on_times(contents, read)
        others = contents.of_other_agents
        mismatch = compare_file(path, (each.header.identity for each in contents.streams))
        remarks += [*others, *([mismatch.sentence] if mismatch else [])]
        if contents.damages:
            remarks.append(f"{path} can be read only in part{contents.why_incomplete}")
        is_timed = not any(each.untimed or each.clock_error or each.part_error for each in read)
        is_whole = is_timed and not (contents.damages or others or doubled)
        return Computed(target, counts, (*refused, *doubled), tuple(remarks), is_whole)


def _on_times(contents: Contents, read: Sequence[Stream]) -> Iterator[str]:
    """Yield what is to be known of the end of a recording, and of the times of its streams."""
    if contents.not_closed:
        yield contents.not_closed
    for each in read:
        title = each.header.title
        if each.untimed:
            yield (
                f"{title}: {each.untimed} samples are left out, because their timestamps are not "
                "numbers"
            )
        if each.repeated:
            yield f"{title}: {repeated_text(each.repeated)}"
        if why := each.clock_error or each.part_error:
            yield f"{title}: {why}, so the times of its features are in doubt"
        for span in each.clock.doubtful_spans:
            yield f"{title}: {span.text(contents.begin_s)}"
        if each.clock.unused:
            yield f"{title}: {each.clock.unused}"


_Parts = tuple[Stream, ...]
"""A stream in the order of time: a recorder begins it again when its outlet comes back."""
_Pairs = Sequence[tuple[_Parts, Source]]


def _in_parts(recorded: Sequence[Stream], rated: Sequence[Stream]) -> list[_Parts]:
    """Join streams that continue each other; those of the same time stay separate."""
    ends = [each.ends() or (-math.inf, -math.inf) for each in recorded]
    found: list[list[int]] = []
    by_id: dict[str, list[list[int]]] = {}
    for at in sorted(range(len(recorded)), key=lambda each: ends[each]):
        begin_s, _ = ends[at]
        twins = by_id.setdefault(recorded[at].header.source_id, [])
        for parts in twins:
            before = parts[-1]
            if ends[before][1] <= begin_s and _is_twin(recorded[before], recorded[at]):
                parts.append(at)
                break
        else:
            twins.append([at])
            found.append(twins[-1])
    found.sort(key=min)
    return [tuple(rated[at] for at in parts) for parts in found]


def _is_twin(one: Stream, other: Stream) -> bool:
    """Whether two streams have the same source_id and the same header."""
    if not one.header.source_id or one.header.source_id != other.header.source_id:
        return False
    # Rates may be those of the samples, which differ a little.
    return replace(one.meaning, rate=other.meaning.rate) == other.meaning


def _sources(streams: Sequence[_Parts]) -> tuple[_Pairs, list[str], list[str]]:
    """Return the sources, why other streams cannot be used, and the duplicates left out."""
    found: list[Source] = []
    refused: list[str] = []
    doubled: list[str] = []
    fullest = [max(parts, key=lambda each: each.sample_count) for parts in streams]
    by_header: dict[int, _Parts] = {}
    for stream, parts in zip(fullest, streams, strict=True):
        if is_feature(stream.header.xml):
            continue  # nothing is dropped: features of features are not asked for
        try:
            source = judge(stream.header.title, stream.header.source_id, stream.meaning)
        except FeatureError as error:
            # nothing is dropped: `refused` is printed
            refused.append(str(error))
            continue  # nothing is dropped: as above
        if source is not None:
            by_header[id(source.header)] = parts
            found.append(source)
    # A stream without samples gets what is left: which of two has any may depend on the model.
    full = [each for each in found if _has_samples(by_header[id(each.header)])]
    empty = [each for each in found if not _has_samples(by_header[id(each.header)])]
    taken: Taken = set()
    chosen = [*choose(full, taken), *choose(empty, taken)]
    kept = {id(each.header): each.features for each in chosen}
    for each in found:
        left = [one for one in each.features if one not in kept.get(id(each.header), ())]
        if left and _is_doubled(
            by_header[id(each.header)], [by_header[id(one.header)] for one in chosen]
        ):
            doubled.append(
                f"no features from one of the streams {each.name!r}: another one was recorded at "
                f"the same time with its source_id, {each.source_id!r}; give each sender its own"
            )
        elif why := left_out(each, left, chosen):
            refused.append(why)
    return [(by_header[id(each.header)], each) for each in chosen], refused, doubled


def _has_samples(parts: _Parts) -> bool:
    return any(each.sample_count for each in parts)


def _is_doubled(parts: _Parts, chosen: Iterable[_Parts]) -> bool:
    return _has_samples(parts) and any(
        each is not parts and _is_twin(each[0], parts[0]) for each in chosen
    )


def _witnesses(pairs: _Pairs) -> Witnesses:
    """Return the witnesses of all devices, over the whole recording."""
    witnesses: Witnesses = {}
    for parts, source in pairs:
        witness = source.new_witness(keep_s=math.inf)
        if witness is not None and _has_samples(parts):
            witnesses[source.key] = witness
            for samples in chain.from_iterable(each.blocks() for each in parts):
                witness.take(samples.stamps, source.scaled(samples.values))
    return witnesses


def _computed(
    stream: Stream, source: Source, witnesses: Witnesses, remarks: list[str]
) -> Iterator[tuple[Samples, list[Event]]]:
    # A copy, because the computer of a witness would replace the one of the whole recording.
    source = replace(source, header=replace(source.header, rate=stream.meaning.rate))
    blocks, steadied = with_steady_stamps(stream)
    is_uneven = not steadied and has_uneven_stamps(stream)
    computer = source.new_computer(dict(witnesses), is_uneven=is_uneven)
    if steadied:
        remarks.append(f"{source.name}: {steadied}")
    if stream.stray:
        remarks.append(f"{source.name}: {stray_text(len(stream.stray))}; it got one between theirs")
    samples: Samples | None = None
    for samples in blocks:
        yield samples, computer.take(samples.stamps, samples.values)
    if samples is not None:
        yield samples, computer.finish()
    if remark := computer.remark():
        remarks.append(remark)


class _Written:
    """A stream of a feature in an XDF file, with the data of its footer."""

    def __init__(self, number: int, parts: _Parts, feature: Feature) -> None:
        self.number, self._feature = number, feature
        self.first = self.last = 0.0
        self.sample_count = 0
        self.clock_offsets = [each for part in parts for each in part.clock_offsets]

    def chunk(self, events: Sequence[Event]) -> bytes:
        # nothing is dropped: each feature has its turn
        own = [each for each in events if each.feature == self._feature.name]
        if not own:
            return b""  # nothing is dropped: there is nothing
        stamps = np.array([each.stamp for each in own])
        values: NDArray[np.float32] = np.array([each.values for each in own], np.float32)
        self.first = self.first if self.sample_count else float(stamps[0])
        self.last, self.sample_count = float(stamps[-1]), self.sample_count + len(own)
        return chunks.samples(self.number, self._feature.stream.format, stamps, values)


def _write_xdf(file: BinaryIO, pairs: _Pairs, begun: str, remarks: list[str]) -> dict[str, int]:
    chunks.begin(file, begun, ())
    counts: dict[str, int] = {}
    witnesses, number = _witnesses(pairs), 0
    for parts, source in pairs:
        written: list[_Written] = []
        names: list[str] = []
        for feature in source.features:
            number += 1
            info = stream_info(source, feature)
            names.append(info.name())
            file.write(chunks.stream_header(number, info.as_xml()))
            written.append(_Written(number, parts, feature))
        for part in parts:
            for each in written:
                for taken_at, offset in part.clock_offsets:
                    file.write(chunks.clock_offset(each.number, taken_at, offset))
            for _, events in _computed(part, source, witnesses, remarks):
                file.writelines(each.chunk(events) for each in written)
        for name, each in zip(names, written, strict=True):
            file.write(chunks.boundary() + chunks.footer(each.number, each))
            counts[name] = each.sample_count
    return counts


def _write_csv(file: BinaryIO, pairs: _Pairs, _begun: str, remarks: list[str]) -> dict[str, int]:
    text = io.TextIOWrapper(file, "utf-8", newline="", write_through=True)
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(["time_s", "stream", "channel", "unit", "value"])
    counts: dict[str, int] = {}
    witnesses = _witnesses(pairs)
    for parts, source in pairs:
        known = {each.name: each for each in source.features}
        names = {name: stream_info(source, each).name() for name, each in known.items()}
        counts |= dict.fromkeys(names.values(), 0)
        for part in parts:
            for samples, events in _computed(part, source, witnesses, remarks):
                to_recorder = _clock(part, samples)
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
