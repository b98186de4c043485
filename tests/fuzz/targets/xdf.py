"""A recording, from its bytes to the report on it.

It is read, or refused with a RecordingError; damages are in the order of the file and
do not overlap; every sample has a stamp; the report can be printed, also as JSON. What can
be salvaged holds the same samples, and is whole.
"""

from __future__ import annotations

import json
from collections import Counter
from itertools import pairwise
from pathlib import Path

from biosensor_gateway.recording.xdf.container import (
    RecordingError,
    RecordingReason,
    open_recording,
)
from biosensor_gateway.recording.xdf.recording import Recording, read_recording
from biosensor_gateway.recording.xdf.report_text import as_json, as_text
from biosensor_gateway.recording.xdf.salvage.outcome import as_json as salvage_as_json
from biosensor_gateway.recording.xdf.salvage.outcome import salvage, salvaged_path
from biosensor_gateway.recording.xdf.salvage.survey import Survey, survey
from biosensor_gateway.recording.xdf.verdict import judge
from tests.fuzz.contract import ensure
from tests.fuzz.scratch import written

_PACKED = b"\x1f\x8b"
_MOST_PACKED = 1024


def check(data: bytes) -> None:
    """Check the recording as ``xdf check`` does."""
    # A file may hold a thousand times its size when it is unpacked, which is no find.
    if data.startswith(_PACKED) and len(data) > _MOST_PACKED:
        return
    try:
        recording = read_recording(written("study.xdf", data))
    except RecordingError as error:
        ensure(str(error) != "", "a refusal without a reason", error)
        return
    _is_sane(recording, len(data))
    report = judge(recording)
    ensure("study.xdf" in as_text(report), "the report is of no file")
    told = json.loads(as_json(report))
    ensure(len(told["streams"]) == len(recording.streams), "not every stream is told", told)
    ensure(told["good"] == report.is_good, "two verdicts", told)
    _is_salvaged(recording)


def _is_salvaged(recording: Recording) -> None:
    target = salvaged_path(recording.path)
    target.unlink(missing_ok=True)
    try:
        outcome = salvage(recording.path, target)
    except RecordingError as error:
        ensure(error.reason is RecordingReason.EMPTY, "it cannot be salvaged", error)
        return
    json.loads(salvage_as_json(outcome))
    if outcome.written is not None:
        counts = [stream.sample_count for stream in recording.streams]
        result = read_recording(outcome.written)
        kept = [stream.sample_count for stream in result.streams]
        if outcome.survey.new_headers:
            # Of a header that was fixed there are samples that nothing else reads.
            ensure(not Counter(counts) - Counter(kept), "samples are not salvaged", counts, kept)
        else:
            cut = [stream.cut is not None for stream in outcome.survey.streams.values()]
            left = [count - is_cut for count, is_cut in zip(counts, cut, strict=True)]
            ensure(kept == left, "other samples are salvaged", counts, kept)
        ensure(survey_of(outcome.written).is_whole, "what was salvaged is not whole")


def _is_sane(recording: Recording, size: int) -> None:
    for before, after in pairwise(recording.damages):
        ensure(before.end <= after.start, "damages overlap", before, after)
    for damage in recording.damages:
        ensure(damage.start <= damage.end <= recording.size, "damaged beyond its end", damage)
    for stream in recording.streams:
        ensure(len(stream.stamps) == stream.sample_count, "not every sample has a stamp")
        ensure(stream.sample_count <= max(size, recording.size), "more samples than bytes")
        counts = stream.nan_counts
        ensure(counts.shape == (stream.header.channel_count,), "other channels", counts)
        within = bool(((counts >= 0) & (counts <= stream.sample_count)).all())
        ensure(within, "more NaN than samples", counts)


def survey_of(path: Path) -> Survey:
    """Read a recording as a salvage does."""
    with open_recording(path) as opened:
        return survey(path, opened)
