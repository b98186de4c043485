"""Writes EMG for BIDS: BDF+ files in ``emg``, with their channels and events.

Numbers have 24 bits. As with EEG, a file continues after a short gap, and a long gap starts a new
run. BDF has no missing values, so the minimum is written instead, with events at these places.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from biosensor_gateway.recording.contents.choice import Chosen
from biosensor_gateway.recording.contents.stream import Stream
from biosensor_gateway.recording.export.bids import sidecars
from biosensor_gateway.recording.export.bids.file_names import Entities
from biosensor_gateway.recording.export.bids.run_file import LONGEST_FILLED_S, RunFile, run_of
from biosensor_gateway.recording.export.bids.tables import NOTHING, write_json
from biosensor_gateway.recording.export.edf.bdf import RATES_HZ, Channel
from biosensor_gateway.recording.export.edf.file import (
    INSTEAD,
    Given,
    Holes,
    channels_of,
    write_stretch,
)
from biosensor_gateway.recording.export.exporter import Order, Times
from biosensor_gateway.recording.export.runs import (
    LONGEST_JOINED_S,
    MOST_RUNS,
    Runs,
    Stretch,
    stretches,
)
from biosensor_gateway.recording.export.timeline import Timeline
from biosensor_gateway.recording.xdf.measuring import is_exact

_EMG = "emg"


def write_emg(
    root: Path,
    chosen: Chosen,
    order: Order,
    stream: Stream,
    entities: Entities,
    label: str,
    timeline: Timeline,
) -> tuple[list[RunFile], list[str]]:
    """Write an EMG stream; return its runs, none if it does not fit BDF, and notes for the user.

    Parameters
    ----------
    label
        Distinguishes the stream from the participant's others.

    Raises
    ------
    OSError
        If a file cannot be written.
    """
    is_even = order.times is Times.EVEN or not is_exact(stream.header)
    cut = Runs(chosen, stream, Times.EVEN if is_even else Times.RECORDED)
    runs = cut.found()
    if not runs or len(runs) > MOST_RUNS:
        return [], []
    longest_s = LONGEST_JOINED_S if order.times is Times.EVEN else LONGEST_FILLED_S
    every = stretches(runs, stream.header.rate, longest_s)
    held = [_held(stream, each) for each in every]
    if not all(held):
        return [], []
    holes = Holes(stream, [each.begin_s for each in every for _ in each.runs])
    for number, samples in cut.pieces():
        holes.take(number, samples)
    notes = [*cut.remarks(every, INSTEAD), *holes.notes()]
    given, files = Given(cut), list[RunFile]()
    for number, (stretch, channels) in enumerate(zip(every, held, strict=True), 1):
        numbers = range(stretch.first, stretch.first + len(stretch.runs))
        missing = [each for at in numbers for each in holes.found[at]]
        (start_s,) = timeline.since_zero(np.array([stretch.begin_s])).tolist()
        file = RunFile(
            _EMG,
            stream,
            run_of(entities, number, len(every)),
            label,
            start_s,
            stretch.rate_hz,
            stretch.rows,
            tuple(stretch.gaps),
            tuple((each.begin_s, each.length_s, each.text) for each in missing),
        )
        path = root / file.path("emg.bdf")
        path.parent.mkdir(parents=True, exist_ok=True)
        write_stretch(chosen, order.clock, stream, stretch, channels, missing, given, path)
        _describe(root, file, stretch, channels, timeline)
        files.append(file)
    return files, notes


def _held(stream: Stream, stretch: Stretch) -> list[Channel]:
    """Return the channels for BDF; none if a channel or the rate does not fit."""
    channels, without = channels_of(stream, stretch)
    is_held = not without and RATES_HZ[0] <= stretch.rate_hz <= RATES_HZ[1]
    return channels if is_held else []


def _describe(
    root: Path, file: RunFile, stretch: Stretch, channels: list[Channel], timeline: Timeline
) -> None:
    names = [each.label for each in channels]
    types = file.write_channels(root, names, [each.dimension or NOTHING for each in channels])
    samples = sum(each.count for each in stretch.runs)
    content = {
        **file.described(),
        "EMGPlacementScheme": "Other",
        "EMGPlacementSchemeDescription": "not known, no header tells it; please fill it in",
        "EMGReference": NOTHING,
        "EMGChannelCount": types.count("EMG"),
        "StartTime": round(file.start_s, 6),
        "SamplingFrequencyNominal": file.stream.header.rate,
        "Samples": samples,
        "EmptyRows": stretch.rows - samples,
        "Gaps": len(file.gaps),
        **sidecars.of_stream(file.stream, timeline),
    }
    write_json(root / file.path("emg.json"), content)
