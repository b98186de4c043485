"""Features of a recording, to XDF and CSV, by the command."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
import pytest
import pyxdf
from typer import Exit, Typer
from typer.testing import CliRunner

from biosensor_common import naming
from biosensor_common.errors import ConfigError, ConfigReason
from biosensor_common.lsl_header import describe
from biosensor_common.quantities import ContentType, Unit
from biosensor_common.spec import DeviceIdentity, DeviceInfo, SensorSpec, StreamSpec
from biosensor_common.table import channels, raw
from biosensor_gateway.cli.features import compute_recording, features
from biosensor_gateway.devices.emotibit import SPEC as EMOTIBIT
from biosensor_gateway.devices.empatica_e4 import SPEC as EMPATICA_E4
from biosensor_gateway.features.offline import compute
from biosensor_gateway.features.outputs import features_of
from biosensor_gateway.recording.contents.choice import Selection
from biosensor_gateway.recording.contents.contents import open_contents
from biosensor_gateway.recording.export.job import Task, export
from tests.features import signals
from tests.recording_export.study import ecg_values, ours
from tests.xdf import xdf_file as made

_COMMAND = Typer()
_COMMAND.command()(features)

BEGIN_S, OFFSET_S = 5000.0, 12.5


def _described(unit: str) -> ET.Element:
    desc = ET.Element("desc")
    channel = ET.SubElement(ET.SubElement(desc, "channels"), "channel")
    ET.SubElement(channel, "label").text = "x"
    if unit:
        ET.SubElement(channel, "unit").text = unit
    return desc


def _own(number: int, spec: StreamSpec, values: signals.Array, rate: float) -> bytes:
    """Return a stream of a watch of ours, which says whose it is."""
    watch = DeviceIdentity("watch", "")
    desc = describe(spec, watch, DeviceInfo(model="any"))
    stamps: list[float] = (BEGIN_S + np.arange(len(values)) / rate).tolist()
    kind, count = spec.content_type.value, len(spec.channels)
    header = made.stream_header(
        number,
        naming.lsl_name(watch, spec.data_name),
        kind=kind,
        rate=rate,
        channels=count,
        source_id=naming.source_id(watch, spec.data_name),
        desc=desc,
    )
    rows = values.reshape(len(values), count).tolist()
    return header + made.samples(number, "float32", rows, stamps)


@pytest.mark.parametrize(("empty", "full"), [("a", "b"), ("b", "a")])
def test_beats_are_of_the_stream_that_has_samples(tmp_path: Path, empty: str, full: str) -> None:
    path, target = tmp_path / "pulse.xdf", tmp_path / "features.xdf"
    specs = [raw(each, ContentType.PPG, channels("counts", "green"), 64) for each in (empty, full)]
    recorded = made.xdf(
        _own(1, specs[0], np.zeros((0, 1)), 64), _own(2, specs[1], signals.pulse(64, 40)[0], 64)
    )
    path.write_bytes(recorded)
    compute_recording(path, target, print_json=False)
    counts = {each["info"]["name"][0]: len(each["time_stamps"]) for each in _loaded(str(target))}
    (beats,) = (count for name, count in counts.items() if name.endswith("-beats"))
    assert beats > 30


def test_whose_it_may_not_be_is_said_of_a_recording(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "sub-P07_task-rest.xdf"
    beats = [
        {"event": "heartbeat", "lsl_time": at, "agent_started": started}
        for at, started in ((1003.0, 900.0), (1008.0, 900.0), (1012.0, 950.0))
    ]
    texts = [[json.dumps(each)] for each in beats]
    stamps = 1000 + np.arange(2600) / 130
    path.write_bytes(
        made.xdf(
            ours(1, "polar_h10", "ecg", ecg_values(2600), stamps, "P01"),
            ours(2, "gateway", "events", texts, [1003.0, 1008.0, 1012.0], ""),
        )
    )
    with pytest.raises(Exit):
        compute_recording(path, tmp_path / "features.csv", print_json=False)
    said = " ".join(capsys.readouterr().out.split())
    assert "from 12.0 s on it belongs to another agent" in said
    assert "the file is called P07, but its sensors are worn by P01" in said


def test_motion_of_a_recording_is_that_of_its_accelerometer(tmp_path: Path) -> None:
    path, target = tmp_path / "walk.xdf", tmp_path / "features.xdf"
    ppg = raw("ppg", ContentType.PPG, channels("counts", "green"), 64)
    acc = raw("acc", ContentType.ACCELEROMETER, channels(Unit.G, "x", "y", "z"), 32)
    moves = np.tile([0.0, 0.0, 1.0], (40 * 32, 1))
    moves[20 * 32 :, 0] = 0.2 * np.sin(2 * np.pi * np.arange(20 * 32) / 32)
    path.write_bytes(made.xdf(_own(1, ppg, signals.pulse(64, 40)[0], 64)) + _own(2, acc, moves, 32))
    compute_recording(path, target, print_json=False)
    (quality,) = [e for e in _loaded(str(target)) if e["info"]["name"][0].endswith("ppg_sqi")]
    stamps, values = quality["time_stamps"] - BEGIN_S, quality["time_series"]
    assert set(values[stamps < 20, 6]) == {0.0}
    assert values[stamps < 20, 0].min() > 0.9
    after = (stamps > 24) & (stamps < 39)
    assert set(values[after, 6]) == {1.0}
    assert values[after, 0].max() < 0.5


@pytest.mark.parametrize(
    ("sensor", "rate", "celsius_hz"),
    [(EMPATICA_E4, 4.0, 4.0), (EMOTIBIT, 15.0, 7.5)],
    ids=["E4", "EmotiBit"],
)
def test_skin_of_a_recording_is_that_of_somebody_who_wears_the_sensor(
    tmp_path: Path, sensor: SensorSpec, rate: float, celsius_hz: float
) -> None:
    path, target = tmp_path / "table.xdf", tmp_path / "features.xdf"
    by_kind = {each.content_type: each for each in sensor.streams}
    gsr, warmth = by_kind[ContentType.GSR], by_kind[ContentType.TEMPERATURE]
    assert (gsr.rate, warmth.rate) == (rate, celsius_hz)
    celsius = np.full(round(60 * celsius_hz), 33.0)
    celsius[round(30 * celsius_hz) :] = 24.0
    skin = _own(1, gsr, signals.skin(rate, 60)[0], rate)
    path.write_bytes(made.xdf(skin) + _own(2, warmth, celsius, celsius_hz))
    compute_recording(path, target, print_json=False)
    streams = _loaded(str(target))
    (quality,) = [e for e in streams if e["info"]["name"][0].endswith("_sqi")]
    stamps, values = quality["time_stamps"] - BEGIN_S, quality["time_series"]
    assert values[stamps < 29, 0].min() == 1
    after = (stamps > 33) & (stamps < 59.5)
    assert after.any()
    assert values[after, 0].max() == 0
    assert values[after, 5].min() == 1
    # Of temperature itself nothing is computed.
    assert len(streams) == len(features_of(ContentType.GSR, "gsr", "microsiemens", rate))


def test_temperature_alone_is_nothing_to_compute_of(tmp_path: Path) -> None:
    path = tmp_path / "table.xdf"
    (warmth,) = (e for e in EMPATICA_E4.streams if e.content_type == ContentType.TEMPERATURE)
    path.write_bytes(made.xdf(_own(1, warmth, np.full(240, 33.0), 4)))
    with pytest.raises(ConfigError) as caught:
        compute_recording(path, tmp_path / "features.xdf", print_json=False)
    assert caught.value.reason is ConfigReason.WRONG_VALUE


def _loaded(path: str) -> list[Any]:
    reader: Any = pyxdf
    loaded: tuple[Any, Any] = reader.load_xdf(
        path, synchronize_clocks=False, dejitter_timestamps=False
    )
    return list(loaded[0])


def _stream(
    number: int,
    kind: str,
    values: signals.Array,
    rate: float,
    unit: str,
    name: str = "",
    **header: Any,
) -> bytes:
    stamps: list[float] = (BEGIN_S + np.arange(len(values)) / rate).tolist()
    rows = values[:, np.newaxis].tolist()
    parts = [
        made.stream_header(
            number, name or f"amp {kind}", kind=kind, rate=rate, desc=_described(unit), **header
        ),
        made.offsets(number, stamps[::500], OFFSET_S),
    ]
    parts += [
        made.samples(number, "float32", rows[at : at + 97], stamps[at : at + 97])
        for at in range(0, len(rows), 97)
    ]
    return b"".join(parts)


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    path = tmp_path / "study.xdf"
    ecg, skin = signals.ecg(130, 40)[0], signals.skin(8, 40)[0]
    path.write_bytes(
        made.xdf(_stream(1, "ECG", ecg, 130, "mV"), _stream(2, "GSR", skin, 8, ""))
        + _stream(3, "Respiration", signals.breath(20, 60), 20, "N")
    )
    return path


def test_a_stream_whose_features_another_one_gives_is_named(tmp_path: Path) -> None:
    path, one = tmp_path / "strap.xdf", {"name": "strap", "source_id": "s1"}
    ecg, pulse = signals.ecg(130, 40)[0], signals.pulse(64, 40)[0]
    path.write_bytes(
        made.xdf(_stream(1, "ECG", ecg, 130, "mV", **one), _stream(2, "PPG", pulse, 64, "", **one))
    )
    result = CliRunner().invoke(_COMMAND, [str(path), "--json"])
    (sentence,) = json.loads(result.output)["refused"]
    assert sentence == (
        "no beats, hr_live, hr_live_quality, hr_state, hrv_live of stream 'strap' of type PPG: "
        "stream 'strap' of type ECG has the source_id 's1' and gives them"
    )


def _ecg_from(number: int, begin_s: float, clock_s: float = OFFSET_S) -> tuple[bytes, list[float]]:
    """Return 30 s of one ECG whose outlet may be in the file again, and its beats."""
    signal, beats = signals.ecg(130, 30)
    stamps: list[float] = (begin_s + np.arange(len(signal)) / 130).tolist()
    header = made.stream_header(number, "amp", kind="ECG", rate=130.0, source_id="a1")
    rows = signal[:, np.newaxis].tolist()
    moments = (stamps[0], stamps[-1])
    content = made.offsets(number, moments, clock_s) + made.samples(number, "float32", rows, stamps)
    return header + content, [begin_s + clock_s + float(each) for each in beats]


@pytest.mark.parametrize("suffix", [".xdf", ".csv"])
def test_a_stream_that_was_recorded_again_has_features_of_both_times(
    tmp_path: Path, suffix: str
) -> None:
    path, target = tmp_path / "study.xdf", tmp_path / f"features{suffix}"
    # Behind the first, and of a computer that was started again in between.
    later, later_beats = _ecg_from(1, 60.0, BEGIN_S)
    first, first_beats = _ecg_from(2, BEGIN_S)
    path.write_bytes(made.xdf(later, first))
    result = CliRunner().invoke(_COMMAND, [str(path), "--output", str(target), "--json"])
    assert result.exit_code == 0, result.output
    assert json.loads(result.output)["refused"] == []
    if suffix == ".csv":
        with target.open(encoding="utf-8", newline="") as file:
            rows = [row for row in csv.DictReader(file) if row["stream"].endswith("-beats")]
        times = [float(row["time_s"]) for row in rows if row["channel"] == "interval"]
    else:
        with open_contents(target) as contents:
            (stream,) = [e for e in contents.streams if e.header.name.endswith("-beats")]
            times = [each for block in stream.blocks() for each in block.times.tolist()]
    for beats in (first_beats, later_beats):
        found = [min(abs(each - beat) for each in times) < 0.05 for beat in beats]
        assert found.count(False) <= 2


def test_two_streams_of_one_source_id_at_one_time_are_no_success(tmp_path: Path) -> None:
    path = tmp_path / "study.xdf"
    path.write_bytes(made.xdf(_ecg_from(1, BEGIN_S)[0], _ecg_from(2, BEGIN_S + 10)[0]))
    result = CliRunner().invoke(_COMMAND, [str(path), "--json"])
    assert result.exit_code == 1
    (sentence,) = json.loads(result.output)["refused"]
    assert sentence == (
        "no features from one of the streams 'amp': another one was recorded at the same time "
        "with its source_id, 'a1'; give each sender its own"
    )


@pytest.mark.parametrize("header_hz", [65.0, 260.0])
def test_a_wrong_rate_in_a_header_costs_no_beat(tmp_path: Path, header_hz: float) -> None:
    path = tmp_path / "study.xdf"
    signal, beats = signals.ecg(130, 40)
    stamps: list[float] = (BEGIN_S + np.arange(len(signal)) / 130).tolist()
    header = made.stream_header(1, "amp", kind="ECG", rate=header_hz, desc=_described("mV"))
    rows = signal[:, np.newaxis].tolist()
    samples = made.samples(1, "float32", rows, stamps)
    path.write_bytes(made.xdf(header, samples, made.footer(1, len(stamps))))
    told = json.loads(CliRunner().invoke(_COMMAND, [str(path), "--json"]).output)
    (count,) = [count for name, count in told["streams"].items() if name.endswith("-beats")]
    assert count == pytest.approx(len(beats), abs=3)
    (remark,) = told["remarks"]
    assert remark.startswith(
        f"amp: its header says {header_hz:g} Hz; it is treated as 130 Hz, the rate"
    )


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("is_burst", [False, True])
def test_the_begin_of_a_recording_with_overlaps_costs_no_sample(
    tmp_path: Path, seed: int, is_burst: bool
) -> None:
    """Live, what came before the first overlap has been passed on; a recording tells beforehand."""
    path = tmp_path / "study.xdf"
    signal, beats = signals.ecg(130, 60)
    late = np.random.default_rng(seed).exponential(0.02, len(signal) // 73 + 1)
    number = np.arange(len(signal))
    measured = number // 73 * 73 + 72 if is_burst else number
    stamps: list[float] = (BEGIN_S + measured / 130 + late[number // 73]).tolist()
    header = made.stream_header(1, "strap", kind="ECG", rate=130.0, desc=_described("mV"))
    rows = signal[:, np.newaxis].tolist()
    path.write_bytes(made.xdf(header, made.samples(1, "float32", rows, stamps)))
    told = json.loads(CliRunner().invoke(_COMMAND, [str(path), "--json"]).output)
    (count,) = [count for name, count in told["streams"].items() if name.endswith("-beats")]
    assert count == pytest.approx(len(beats), abs=2)
    assert not any("left out" in each for each in told["remarks"])


def test_types_are_found_however_they_are_spelt(tmp_path: Path) -> None:
    path = tmp_path / "study.xdf"
    spelt = [
        ("ecg", signals.ecg(130, 40)[0], 130, "mV"),
        ("Eda", signals.skin(8, 40)[0], 8, "uS"),
        ("RESP", signals.breath(20, 60), 20, "N"),
    ]
    streams = (_stream(at, *each) for at, each in enumerate(spelt, 1))
    path.write_bytes(made.xdf(*streams))
    computed = compute(path, tmp_path / "features.csv")
    counts = {name: count for name, count in computed.counts.items() if count}
    for name in ("-beats", "-scr", "-br_live"):
        assert any(each.endswith(name) for each in counts), (name, counts)
    task = Task(["kubios", "ledalab"], Selection(), output=tmp_path)
    outcome = export(path, task, lambda _name, _s: lambda _done: None)
    assert [each.format for each in outcome.written] == ["kubios", "ledalab"]
    texts = [each.name for each in tmp_path.rglob("amp_*.txt")]
    assert sorted(texts) == ["amp_Eda.txt", "amp_ecg.txt"]


@pytest.mark.parametrize("what", ["late first packets", "a clock that stands still", "to the end"])
def test_samples_whose_stamps_tell_nothing_are_used_and_it_is_said(
    what: str, tmp_path: Path
) -> None:
    signal, beats = signals.ecg(130, 60)
    stamps = BEGIN_S + np.arange(len(signal)) / 130
    if what == "late first packets":
        stamps[:100] = stamps[100] + np.arange(100) / 1000
    else:
        end = None if what == "to the end" else 4550
        stamps[3900:end] = stamps[3900]
    header = made.stream_header(1, "amp", kind="ECG", rate=130.0, source_id="a1")
    rows, times = signal[:, np.newaxis].tolist(), stamps.tolist()
    parts = [
        made.samples(1, "float32", rows[at : at + 65], times[at : at + 65])
        for at in range(0, len(rows), 65)
    ]
    path, target = tmp_path / "study.xdf", tmp_path / "features.csv"
    path.write_bytes(made.xdf(header, *parts))
    result = CliRunner().invoke(_COMMAND, [str(path), "--output", str(target), "--json"])
    assert result.exit_code == 0, result.output
    (remark,) = (each for each in json.loads(result.output)["remarks"] if "line" in each)
    assert ("came late" if what == "late first packets" else "stood still") in remark
    assert "left out" not in result.output
    with target.open(encoding="utf-8", newline="") as file:
        found = [row for row in csv.DictReader(file) if row["stream"].endswith("-beats")]
    told = np.unique([float(row["time_s"]) for row in found]) - BEGIN_S
    assert len(told) >= len(beats) - 3
    assert np.abs(told[:, np.newaxis] - beats).min(axis=1).max() < 0.06


def test_stamps_in_milliseconds_are_no_silence(tmp_path: Path) -> None:
    path = tmp_path / "study.xdf"
    stamps: list[float] = (1e3 * (BEGIN_S + np.arange(2600) / 130)).tolist()
    header = made.stream_header(1, "amp", kind="ECG", rate=130.0, desc=_described("mV"))
    path.write_bytes(made.xdf(header, made.samples(1, "float32", [[0.5]] * 2600, stamps)))
    result = CliRunner().invoke(_COMMAND, [str(path)])
    assert isinstance(result.exception, ConfigError)
    assert "'amp' has 0.13 Hz; features of ECG need 80" in str(result.exception)


def test_a_recording_gives_what_comes_live_to_the_last_bit(recording: Path) -> None:
    result = CliRunner().invoke(_COMMAND, [str(recording), "--json"])
    assert result.exit_code == 0, result.output
    told = json.loads(result.output)
    assert len(told["refused"]) == 1
    assert "'amp GSR' has no unit" in told["refused"][0]
    streams = _loaded(told["written"])
    assert {each["info"]["name"][0]: len(each["time_stamps"]) for each in streams} == told[
        "streams"
    ]
    (beats,) = [each for each in streams if each["info"]["name"][0].endswith("-beats")]
    ecg = signals.ecg(130, 40)[0].astype(np.float32).astype(np.float64)
    live = signals.events_of("ECG", ecg, 130, list(range(0, 6000, 11)), BEGIN_S)
    assert beats["time_stamps"].tolist() == [e.stamp for e in live if e.feature == "beats"]
    expected = signals.values_of(live, "beats").astype(np.float32)
    assert np.array_equal(beats["time_series"], expected, equal_nan=True)
    assert float(beats["footer"]["info"]["clock_offsets"][0]["offset"][0]["value"][0]) == OFFSET_S


def test_a_table_has_the_same_on_the_recorders_clock(recording: Path, tmp_path: Path) -> None:
    table = tmp_path / "features.csv"
    result = CliRunner().invoke(_COMMAND, [str(recording), "--output", str(table)])
    assert result.exit_code == 0, result.output
    with table.open(newline="") as file:
        rows = [each for each in csv.DictReader(file) if each["stream"].endswith("-beats")]
    intervals = [each for each in rows if each["channel"] == "interval"]
    ecg = signals.ecg(130, 40)[0].astype(np.float32).astype(np.float64)
    live = signals.events_of("ECG", ecg, 130, begin_s=BEGIN_S)
    times = [float(each["time_s"]) for each in intervals]
    stamps = np.array([e.stamp for e in live if e.feature == "beats"])
    assert times == pytest.approx(stamps + OFFSET_S, abs=1e-6)
    assert intervals[0]["value"] == ""
    told = np.array([float(each["value"]) for each in intervals[1:]], np.float32)
    assert np.array_equal(told, signals.values_of(live, "beats")[1:, 0].astype(np.float32))


def test_features_of_features_are_not_computed_and_nothing_is_overwritten(
    recording: Path, tmp_path: Path
) -> None:
    computed = tmp_path / "features.xdf"
    compute_recording(recording, computed, print_json=False)
    for file, target, reason in (
        (computed, tmp_path / "other.xdf", ConfigReason.WRONG_VALUE),
        (recording, computed, ConfigReason.EXISTS),
        (recording, tmp_path / "table.txt", ConfigReason.WRONG_VALUE),
        (tmp_path / "nowhere.xdf", tmp_path / "other.xdf", ConfigReason.UNREADABLE),
    ):
        with pytest.raises(ConfigError) as caught:
            compute_recording(file, target, print_json=False)
        assert caught.value.reason is reason
