"""Check and all exports agree on markers, on where runs end, and on how many samples there are."""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
import pytest
from edfio import read_bdf
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from biosensor_gateway.features.offline import compute
from biosensor_gateway.recording.bag.conversion import import_bag
from biosensor_gateway.recording.contents.choice import Selection, choose
from biosensor_gateway.recording.contents.contents import open_contents
from biosensor_gateway.recording.contents.stream import Samples
from biosensor_gateway.recording.export.edf.edf_exporter import Span, dealt_to_spans
from biosensor_gateway.recording.export.marker_events import markers
from biosensor_gateway.recording.export.outcome import Outcome, Written
from biosensor_gateway.recording.replay import playback
from biosensor_gateway.recording.replay.player import Player, PlayOptions
from biosensor_gateway.recording.xdf.container import RecordingError
from biosensor_gateway.recording.xdf.findings import Level
from biosensor_gateway.recording.xdf.salvage.outcome import after_table, salvage
from biosensor_gateway.recording.xdf.verdict import verdict
from tests.page.test_whose import Page
from tests.recording_export.bids_shapes import read
from tests.recording_export.conftest import Exporting
from tests.recording_export.study import BEGIN_S
from tests.xdf import xdf_file as made
from tests.xdf.checking import check, load_by_pyxdf

Array = NDArray[np.float64]

RATE, COUNT, BURST = 130.0, 2600, 65
BATCH = 150
"""Exports take so many values at once, so that batches fill and gaps stand at their borders."""
TEXTS = ["begin", "in the middle", "end"]
MOMENTS = [0.5, 10.0, 19.5]


def _even(begin: float = 0.0, count: int = COUNT) -> Array:
    return BEGIN_S + begin + np.arange(count) / RATE


def _signal(
    stamps: Array,
    number: int = 1,
    name: str = "ecg",
    rate: float = RATE,
    chunk: int = 100,
    *,
    ends: bool = True,
) -> bytes:
    header = made.stream_header(number, name, kind="ECG", rate=rate, source_id=f"id{number}")
    parts = _chunks(stamps, number, chunk)
    return header + b"".join(parts) + (made.footer(number, len(stamps)) if ends else b"")


def _chunks(stamps: Array, number: int = 1, chunk: int = 100) -> list[bytes]:
    values = np.sin(np.arange(len(stamps), dtype=np.float32))[:, np.newaxis]
    rows, times = values.tolist(), stamps.tolist()
    return [
        made.samples(number, "float32", rows[at : at + chunk], times[at : at + chunk])
        for at in range(0, len(times), chunk)
    ]


def _events(
    number: int = 2, kind: str = "Markers", fmt: str = "string", away_s: float = 0.0
) -> bytes:
    values = [[text] if fmt == "string" else [at] for at, text in enumerate(TEXTS, 1)]
    stamps = [BEGIN_S + away_s + each for each in MOMENTS]
    header = made.stream_header(number, "events", kind=kind, fmt=fmt)
    return header + made.samples(number, fmt, values, stamps) + made.footer(number, len(TEXTS))


def _bursts() -> bytes:
    return _signal(np.repeat(_even()[BURST - 1 :: BURST], BURST))


def _overlaps() -> bytes:
    late = np.random.default_rng(1).exponential(0.02, COUNT // BURST)
    return _signal(_even() + np.repeat(late, BURST))


def _with_gap(at: int, step_s: float) -> bytes:
    stamps = _even()
    stamps[at:] += step_s
    return _signal(stamps)


def _twice(*, behind: int = 0, counted: int = COUNT) -> bytes:
    """A chunk of 100 samples that was written twice, behind a header that was."""
    header = made.stream_header(1, "ecg", kind="ECG", rate=RATE, source_id="id1")
    parts = _chunks(_even())
    parts.insert(10 + behind, parts[9])
    return header + header + b"".join(parts) + made.footer(1, counted)


def _stamped_again() -> bytes:
    """Other samples have the timestamps of the 100 before."""
    stamps = _even()
    return _signal(np.concatenate([stamps[:1000], stamps[900:1000], stamps[1000:]]))


def _begun_again() -> bytes:
    """The sender's computer was started again behind 1000 samples."""
    stamps, number = _even(), 1
    first, second = stamps[:1000].tolist(), (stamps[1000:] - stamps[1000] + 5.0).tolist()
    values = np.sin(np.arange(COUNT, dtype=np.float32))[:, np.newaxis].tolist()
    return b"".join(
        (
            made.stream_header(number, "ecg", kind="ECG", rate=RATE, source_id="id1"),
            made.offsets(number, (first[0], first[-1])),
            made.samples(number, "float32", values[:1000], first),
            made.offsets(number, (second[0], second[-1]), float(stamps[1000]) - 5.0),
            made.samples(number, "float32", values[1000:], second),
            made.footer(number, COUNT),
        )
    )


def _future() -> bytes:
    stamps = _even()
    stamps[1300] += 200_000.0
    return _signal(stamps)


SHAPES: dict[str, Sequence[bytes]] = {
    "even": [_signal(_even()), _events()],
    "bursts": [_bursts(), _events()],
    "overlaps": [_overlaps(), _events()],
    "a gap": [_with_gap(1000, 4.0), _events()],
    "a gap within a chunk": [_with_gap(1050, 4.0), _events()],
    "a clock that was set back": [_with_gap(1000, -5.0), _events()],
    "a step of half a second": [_with_gap(1000, 0.5), _events()],
    "a stamp from the future": [_future(), _events()],
    "a chunk twice": [_twice(), _events()],
    "a chunk twice, some chunks apart": [_twice(behind=3, counted=COUNT + 100), _events()],
    "stamps that come again": [_stamped_again(), _events()],
    "a clock that began again": [_begun_again(), _events()],
    "two of one name": [_signal(_even()), _signal(_even(), 3), _events()],
    "lower-case markers": [_signal(_even()), _events(kind="markers")],
    "numbers as markers": [_signal(_even()), _events(kind="Trigger", fmt="int32")],
    "markers on a game's clock": [_signal(_even()), _events(away_s=-BEGIN_S)],
    "unix stamps": [_signal(_even() + 1.7e9), _events(away_s=1.7e9)],
    "no rate in the header": [_signal(_even(), rate=0.0), _events()],
    "no footer": [_signal(_even(), ends=False), _events()],
    "no sample": [_signal(_even(count=0)), _events()],
    "one sample": [_signal(_even(count=1)), _events()],
    "no marker": [_signal(_even())],
}
# What the format cannot hold, and says.
WITHOUT_EDF = {"no sample"}


def _of(outcome: Outcome, name: str) -> Written | None:
    return next((each for each in outcome.written if each.format == name), None)


def _events_of_bids(written: Written) -> list[str]:
    found: list[str] = []
    for path in sorted(written.path.rglob("*events.tsv")):
        with path.open(encoding="utf-8", newline="") as file:
            rows = list(csv.DictReader(file, delimiter="\t"))
        found += [row["value"] for row in rows if row["stream"] == "events"]
    return found


@pytest.mark.parametrize("shape", SHAPES)
def test_all_agree(shape: str, exported: Exporting) -> None:
    content = made.xdf(*SHAPES[shape])
    report = check(content)
    signals = [each for each in report.streams if each.name == "ecg"]
    outcome = exported(content, "csv", "edf", "kubios", "bids", "mcap", batch=BATCH)
    texts = TEXTS if shape != "numbers as markers" else ["1", "2", "3"]
    expected = [] if shape == "no marker" else texts

    # Every sample is in the table, whatever its stamp.
    table = _of(outcome, "csv")
    assert table is not None
    tables = sorted(table.path.glob("ecg*.csv"))
    rows = [len(path.read_text().splitlines()) - 1 for path in tables]
    assert rows == [each.stream.sample_count for each in signals]

    # One file for each run, which is what check has found.
    edf = _of(outcome, "edf")
    if shape in WITHOUT_EDF:
        assert edf is None or not list(edf.path.glob("ecg*.bdf"))
    else:
        assert edf is not None
        files = sorted(edf.path.glob("ecg*.bdf"))
        paces = [each.figures.pace for each in signals]
        runs = [1 if each is None else 1 + len(each.cuts) for each in paces]
        assert len(files) == sum(runs)
        kubios = _of(outcome, "kubios")
        assert kubios is not None
        of_csv, of_kubios = (each.path / "all_markers.csv" for each in (table, kubios))
        assert of_kubios.exists() == (shape != "no marker")
        if shape != "no marker":
            assert of_kubios.read_bytes() == of_csv.read_bytes()
            heads, *happened = csv.reader(of_kubios.read_text().splitlines())
            assert [row[heads.index("marker")] for row in happened] == expected
        texts_of_kubios = sorted(kubios.path.glob("ecg*.txt"))
        assert [each.stem for each in texts_of_kubios] == [each.stem for each in files]
        # The samples of each stream, in their order, and none twice.
        values = [float(value) for each in texts_of_kubios for value in each.read_text().split()]
        columns = [np.loadtxt(each, skiprows=1, delimiter=",", ndmin=2)[:, 2] for each in tables]
        assert values == pytest.approx(np.concatenate(columns).tolist())
        told_hz = [
            float(rate)
            for note in kubios.notes
            if "tell Kubios" in note
            for rate in re.findall(r"([\d.]+) Hz", note)
        ]
        assert told_hz == pytest.approx([RATE] * len(told_hz), rel=2e-3)
        assert len(told_hz) == sum(count > 0 for count in rows)
        told = {note.text for path in files for note in read_bdf(path).annotations} & set(expected)
        assert told == set(expected)
        for path in files:
            (signal,) = read_bdf(path).signals
            assert signal.sampling_frequency == pytest.approx(RATE, rel=2e-3)

    bids = _of(outcome, "bids")
    assert bids is not None
    assert sorted(_events_of_bids(bids)) == sorted(expected) or any(
        "events" in note for note in bids.notes
    ), bids.notes
    sidecars = [json.loads(path.read_text()) for path in bids.path.rglob("*ecg*physio*.json")]
    assert sum(each["Samples"] for each in sidecars) == sum(rows)
    # A gap is empty rows of a table; another begins where time steps back by more than a second.
    parts = 2 if shape == "a clock that was set back" else len(signals)
    assert len(sidecars) == (0 if shape == "no sample" else parts)


# What others are told of the samples of a shape, whose stamps are not those of its CSV table.
ON_A_LINE = {"bursts", "overlaps", "a stamp from the future"}


@pytest.mark.parametrize("shape", SHAPES)
def test_a_stream_has_one_name_one_count_and_one_time(
    shape: str, exported: Exporting, tmp_path: Path
) -> None:
    content = made.xdf(*SHAPES[shape])
    report = check(content)
    counts = sorted((each.name, each.stream.sample_count) for each in report.streams)
    outcome = exported(content, "csv", "edf", "kubios", "bids", "mcap", batch=BATCH)
    assert sorted((name, count) for name, _, count in outcome.streams) == counts

    # The table and the bag have the stamps of the file.
    table, bag = _of(outcome, "csv"), _of(outcome, "mcap")
    assert table is not None
    assert bag is not None
    tables = [
        np.loadtxt(each, skiprows=1, delimiter=",", ndmin=2)
        for each in sorted(table.path.glob("ecg*.csv"))
        if shape != "no sample"
    ]
    columns = [each[:, 0] for each in tables]
    zero_s = next((float(each[0, 0] - each[0, 1]) for each in tables), 0.0)
    import_bag(bag.path, tmp_path / "again.xdf")
    with open_contents(tmp_path / "again.xdf") as contents:
        assert sorted((each.header.name, each.sample_count) for each in contents.streams) == counts
        again = [_times(each.blocks()) for each in contents.streams if each.header.name == "ecg"]
    again = [each for each in again if len(each)]
    for times, column in zip(again, columns, strict=True):
        assert np.sort(times) == pytest.approx(np.sort(column), abs=2e-6)

    # A replay has them, too, but for what is far from all others, and says what it leaves out.
    path = tmp_path / "study.xdf"
    with open_contents(path) as contents:
        player = Player(choose(contents, Selection()), PlayOptions(), "hash")
        said = " ".join(playback.left_out(player))
        played = {each.number: _times(player.samples(each)) for each in player.streams}
        for each in contents.streams:
            assert len(played.get(each.number, ())) == each.sample_count or each.header.name in said
        signals = [played[each.number] for each in player.streams if each.header.name == "ecg"]
        signals = [each for each in signals if len(each)]
        assert player.end_s - player.begin_s == pytest.approx(report.extent.length_s, abs=0.1)
    for times, column in zip(signals, columns, strict=True):
        far = int(np.count_nonzero(np.abs(times - column) > 2e-6))
        assert far == (1 if shape == "a stamp from the future" else 0)
    assert ("far from those" in said) == (shape == "a stamp from the future")

    # Each run begins at the same time in all formats with runs.
    if shape in WITHOUT_EDF:
        return
    edf, kubios, bids = _of(outcome, "edf"), _of(outcome, "kubios"), _of(outcome, "bids")
    assert edf is not None
    assert kubios is not None
    assert bids is not None
    begins = [_begin_s(each) for each in sorted(edf.path.glob("ecg*.bdf"))]
    told = [
        zero_s + float(seconds)
        for note in kubios.notes
        for seconds in re.findall(r"begins at ([-\d.]+) s", note)
    ]
    assert told == pytest.approx(begins, abs=1e-3)
    starts = sorted(
        zero_s + json.loads(path.read_text())["StartTime"]
        for path in bids.path.rglob("*ecg*physio*.json")
    )
    if len(starts) == len(begins):
        assert starts == pytest.approx(begins, abs=1e-3)
    else:
        assert starts == pytest.approx(begins[:1], abs=1e-3)
    if shape not in ON_A_LINE:
        firsts = sorted(float(column[0]) for column in columns)
        assert begins[: len(firsts)] == pytest.approx(firsts, abs=1e-3)


@pytest.mark.parametrize("shape", SHAPES)
def test_ledalab_has_each_sample_and_each_marker_at_its_sample(
    shape: str, exported: Exporting
) -> None:
    content = made.xdf(*SHAPES[shape]).replace(b"<type>ECG</type>", b"<type>GSR</type>")
    if shape == "no sample":
        with pytest.raises(RecordingError, match="it has no values"):
            exported(content, "ledalab", batch=BATCH)
        return
    outcome = exported(content, "csv", "edf", "ledalab", batch=BATCH)
    written = [_of(outcome, each) for each in ("csv", "edf", "ledalab")]
    table, edf, ledalab = (each for each in written if each is not None)
    signals = [each for each in check(content).streams if each.name == "ecg"]
    files = sorted(ledalab.path.glob("ecg*.txt"))
    assert [each.stem for each in files] == [each.stem for each in sorted(table.path.glob("ecg*"))]
    for path, signal, column in zip(files, signals, sorted(table.path.glob("ecg*")), strict=True):
        rows = np.loadtxt(path, ndmin=2)
        values = np.loadtxt(column, skiprows=1, delimiter=",", ndmin=2)[:, 2]
        assert rows[:, 1] == pytest.approx(values.tolist())
        assert rows[0, 0] == pytest.approx(_begin_s(min(edf.path.glob("ecg*.bdf"))), abs=1e-3)
        has_marker = rows[:, 2] > 0
        moments = np.array([each + (1.7e9 if shape == "unix stamps" else 0.0) for each in MOMENTS])
        away_s = rows[has_marker, 0][:, np.newaxis] - BEGIN_S - moments
        late = [note for note in ledalab.notes if "fell where samples are missing" in note]
        assert (np.abs(away_s).min(axis=1, initial=np.inf) <= 1 / RATE).all() or late
        notes = " ".join(ledalab.notes)
        assert (has_marker.sum() == 3) or shape == "no marker" or "of the markers" in notes
        # What check says of its runs is said here, too.
        pace = signal.figures.pace
        assert ("missing" in notes) == bool(pace and pace.holes)
        assert ("steps back" in notes) == bool(pace and pace.turns)


def _begin_s(path: Path) -> float:
    (told,) = (each.text for each in read_bdf(path).annotations if each.text.startswith("LSL time"))
    return float(told.split()[2])


def _times(blocks: Iterable[Samples]) -> Array:
    return np.concatenate([np.empty(0), *(each.times for each in blocks)])


@pytest.mark.parametrize("shape", SHAPES)
def test_the_page_has_the_verdict_and_the_markers_of_the_command(
    shape: str, tmp_path: Path
) -> None:
    content = made.xdf(*SHAPES[shape])
    path = tmp_path / "study.xdf"
    path.write_bytes(content)
    (tmp_path / "state").mkdir()
    code, judged = Page(tmp_path / "state", "").ask("POST", "recordings/check", {"path": str(path)})
    found = verdict(check(content))
    assert (code, judged["colour"], judged["sentence"]) == (200, found.colour, found.sentence)
    with open_contents(path) as contents:
        expected = [text for _, text in markers(choose(contents, Selection()))]
    assert [each["text"] for each in judged["markers"]] == expected
    texts = ["1", "2", "3"] if shape == "numbers as markers" else TEXTS
    assert expected == ([] if shape == "no marker" else texts)


@pytest.mark.parametrize("shape", SHAPES)
def test_features_read_each_signal_or_say_why_not(shape: str, tmp_path: Path) -> None:
    path = tmp_path / "study.xdf"
    path.write_bytes(made.xdf(*SHAPES[shape]))
    computed = compute(path, tmp_path / "features.csv")
    assert any(name.endswith("-ecg_sqi") for name in computed.counts)
    # What is done about stamps is said, of the shapes that need it and of no other.
    needs = {
        "bursts": "even timestamps",
        "overlaps": "even timestamps",
        "a stamp from the future": "far from those before and after",
        "a clock that was set back": "step",
        "a chunk twice": "in the file twice",
        "a chunk twice, some chunks apart": "in the file twice",
        "stamps that come again": "left out",
        "a clock that began again": "step",
        "unix stamps": "unix time",
        "no rate in the header": "names no rate",
        "no footer": "was not closed",
    }
    told = " ".join(computed.remarks)
    assert (needs[shape] in told) if shape in needs else not told, told


# Markers of any kind are the same in all formats, and none is lost unsaid.

SKIN_RATE_HZ = 10.0
KINDS = [
    ("Markers", "string"),
    ("markers", "string"),
    ("Marker", "string"),
    ("Trigger", "string"),
    ("StringMarker", "string"),
    ("BCI", "string"),
    ("Markers", "int32"),
    ("trigger", "float32"),
    ("Stim", "int16"),
]


def _skin(*spans: tuple[float, float]) -> bytes:
    """Conductance in these spans of seconds since the begin."""
    stamps = (
        np.concatenate([np.arange(begin, end, 1 / SKIN_RATE_HZ) for begin, end in spans]) + BEGIN_S
    )
    values = np.full((len(stamps), 1), 2.0)
    header = made.stream_header(1, "skin", kind="GSR", rate=SKIN_RATE_HZ)
    return header + made.samples(1, "float32", values.tolist(), stamps.tolist())


def _markers(number: int, kind: str, fmt: str, told: dict[float, str]) -> bytes:
    values = [[text] if fmt == "string" else [float(text)] for text in told.values()]
    header = made.stream_header(number, f"told {number}", kind=kind, fmt=fmt)
    return header + made.samples(number, fmt, values, [BEGIN_S + each for each in told])


def _folder(outcome: Outcome, name: str) -> Path:
    (written,) = (each for each in outcome.written if each.format == name)
    return written.path


def _notes(outcome: Outcome, name: str) -> list[str]:
    (written,) = (each for each in outcome.written if each.format == name)
    return [each for each in written.notes if "marker" in each]


def _annotated(path: Path) -> list[tuple[float, str]]:
    told = [(round(each.onset, 3), each.text) for each in read_bdf(path).annotations]
    return [each for each in told if not each[1].startswith(("LSL time", "end of data"))]


@pytest.mark.parametrize(("kind", "fmt"), KINDS)
def test_markers_of_any_type_are_in_every_format(kind: str, fmt: str, exported: Exporting) -> None:
    content = made.xdf(_skin((0, 10)), _markers(2, kind, fmt, {1.0: "7", 2.5: "8"}))
    outcome = exported(content, "edf", "ledalab", "bids")
    number = {"string": "{}", "float32": "{}.0"}.get(fmt, "{}")
    texts = [number.format(each) for each in (7, 8)]
    assert _annotated(_folder(outcome, "edf") / "skin.bdf") == [(1.0, texts[0]), (2.5, texts[1])]
    lines = (_folder(outcome, "ledalab") / "markers.csv").read_text().split()
    assert lines[1:] == [f'1,"{texts[0]}"', f'2,"{texts[1]}"']
    events = read(_folder(outcome, "bids"), "_events")
    assert events.of("value") == texts
    assert all(_notes(outcome, each.format) == [] for each in outcome.written)


def test_markers_outside_of_samples_are_in_the_file_before(exported: Exporting) -> None:
    told = {-500.0: "game", -1.0: "before", 1.0: "in", 12.0: "gap", 21.0: "in 2", 40.0: "after"}
    content = made.xdf(_skin((0, 10), (20, 30)), _markers(2, "markers", "string", told))
    outcome = exported(content, "edf", "ledalab")
    folder = _folder(outcome, "edf")
    assert _annotated(folder / "skin_run1.bdf") == [
        (-500.0, "game"),
        (-1.0, "before"),
        (1.0, "in"),
        (12.0, "gap"),
    ]
    assert _annotated(folder / "skin_run2.bdf") == [(1.0, "in 2"), (20.0, "after")]
    (note,) = _notes(outcome, "edf")
    assert note.startswith("skin: 4 of the markers came outside its samples")
    outside, late = _notes(outcome, "ledalab")
    assert outside.startswith("skin: 3 of the markers came before its first or after its last")
    assert outside.endswith("only all_markers.csv has them")
    rows = (_folder(outcome, "ledalab") / "all_markers.csv").read_text().splitlines()[1:]
    assert [row[2] for row in csv.reader(rows)] == list(told.values())
    assert late.startswith("skin: 1 of the markers fell where samples are missing")


def test_a_marker_that_is_cut_off_is_said(exported: Exporting) -> None:
    texts = {1.0: "x" * 256, 2.0: "y" * 257}
    content = made.xdf(_skin((0, 10)), _markers(2, "Markers", "string", texts))
    outcome = exported(content, "edf")
    assert not outcome.is_whole
    whole, cut = (text for _, text in _annotated(_folder(outcome, "edf") / "skin.bdf"))
    assert whole == texts[1.0]
    assert texts[2.0].startswith(cut.removesuffix("..."))
    (note,) = _notes(outcome, "edf")
    assert note.startswith("1 marker is cut off after 256 characters")


def test_very_many_markers_after_the_end_make_no_large_file(exported: Exporting) -> None:
    told = {40.0 + number / 100: f"number {number}" for number in range(1000)}
    content = made.xdf(_skin((0, 60)), _markers(2, "markers", "string", told))
    path = _folder(exported(content, "edf"), "edf") / "skin.bdf"
    assert len(_annotated(path)) == 1000
    assert path.stat().st_size < 200_000


TIME = st.integers(-5, 60).map(float)


@given(
    times=st.lists(TIME),
    begins=st.lists(st.tuples(TIME, st.integers(1, 9)), min_size=1),
)
def test_each_marker_is_in_one_file_at_least(
    times: list[float], begins: list[tuple[float, int]]
) -> None:
    spans = [Span(begin, begin + length) for begin, length in begins]
    happened = sorted((time, str(number)) for number, time in enumerate(times))
    found, outside = dealt_to_spans(happened, spans)
    assert {each for file in found for each in file} == set(happened)
    inside = {(time, text) for time, text in happened if any(a <= time < b for a, b in spans)}
    assert outside == len(happened) - len(inside)
    for span, file in zip(spans, found, strict=True):
        assert {each for each in inside if span.begin_s <= each[0] < span.end_s} <= set(file)


@pytest.mark.parametrize("shape", ["a chunk twice", "a chunk twice, some chunks apart"])
def test_a_chunk_that_was_written_twice_is_one_truth(
    shape: str, exported: Exporting, tmp_path: Path
) -> None:
    """Each sample is used once, by all, and all say it with one sentence."""
    content = made.xdf(*SHAPES[shape])
    said = "100 samples are in the file twice, each with its timestamp, and used once"
    report = check(content)
    (found,) = (each for each in report.findings if each.stream == "ecg" and said in each.text)
    assert (found.code, found.level) == ("repeated", Level.WARNING)
    assert {"backwards", "gaps", "late-first", "footer-count"}.isdisjoint(
        each.code for each in report.findings
    )
    assert report.streams[0].stream.sample_count == COUNT
    outcome = exported(content, "csv", "edf", "kubios", "bids", "mcap", batch=BATCH)
    assert f"ecg: {said}" in outcome.clock_notes
    (edf,) = _folder(outcome, "edf").glob("ecg*.bdf")
    assert len(read_bdf(edf).signals[0].data) >= COUNT
    path = tmp_path / "study.xdf"
    assert f"ecg: {said}" in compute(path, tmp_path / "features.csv").remarks
    with open_contents(path) as contents:
        player = Player(choose(contents, Selection()), PlayOptions(), "hash")
        assert f"warning: ecg: {said}" in list(playback.left_out(player))
        assert len(_times(player.samples(player.streams[0]))) == COUNT
    mended = tmp_path / "mended.xdf"
    told = salvage(path, mended)
    assert f"ecg: {said}" in list(after_table(told))
    assert not check(mended.read_bytes()).can_be_salvaged
    plain = check(made.xdf(*SHAPES["even"]))
    assert check(mended.read_bytes()).findings == plain.findings
    ecg = next(e for e in load_by_pyxdf(mended) if e["info"]["name"] == ["ecg"])
    assert ecg["time_stamps"] == pytest.approx(_even())


@pytest.mark.parametrize("kind", ["one marker", "a sensor on the table", "no timestamp"])
def test_what_may_have_been_sent_twice_is_kept_twice(kind: str) -> None:
    header = made.stream_header(1, "ecg", kind="ECG", rate=RATE, source_id="id1")
    if kind == "one marker":
        header = made.stream_header(1, "events", kind="Markers", fmt="string")
        chunk = made.samples(1, "string", [["go"]], [BEGIN_S])
    else:
        stamp = None if kind == "no timestamp" else BEGIN_S
        chunk = made.samples(1, "float32", [[0.0]] * 10, [stamp] * 10)
    report = check(made.xdf(header, chunk, chunk))
    assert report.streams[0].stream.sample_count == (2 if kind == "one marker" else 20)
