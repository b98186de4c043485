"""Sources of live features: what a header must say, steady stamps, outlets that change."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from dataclasses import replace
from functools import cache
from typing import Any, cast

import numpy as np
import pylsl
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from pylsl import util

from biosensor_common import naming
from biosensor_common.errors import SpecError
from biosensor_common.lsl import inlet as inlet_module
from biosensor_common.lsl.inlet import read_description
from biosensor_common.lsl_header import append_children, describe, read_header
from biosensor_common.quantities import ChannelFormat, ContentType, Unit
from biosensor_common.spec import DeviceIdentity, DeviceInfo, StreamSpec
from biosensor_common.stream_header import CoreFields, Derived, Replay, StreamHeader, foreign_header
from biosensor_common.table import channels, raw
from biosensor_gateway.devices.muse import SPEC as MUSE
from biosensor_gateway.features import live as live_module
from biosensor_gateway.features.even_stamps import EvenStamps
from biosensor_gateway.features.live import DUPLICATE_S, SETTLED_S, SILENT_S, Live
from biosensor_gateway.features.outputs import TYPES
from biosensor_gateway.features.runs import Event
from biosensor_gateway.features.sources import (
    FeatureError,
    FeatureReason,
    Source,
    Taken,
    choose,
    is_feature,
    judge,
    stream_info,
)
from tests.features import signals
from tests.xdf.test_pace import BURST, NOMINAL_HZ, bursts, delays, measured, overlaps, without

# What a header must say, and what is told of one that does not.


def _header(
    kind: str,
    unit: str = "microvolts",
    rate: float = 130.0,
    name: str = "ECG Amp 1",
    form: ChannelFormat = ChannelFormat.FLOAT32,
    channels: int = 1,
) -> StreamHeader:
    core = CoreFields(name, kind, f"{name}-id", "host", channels, rate, form)
    return foreign_header(core, ("x",) * channels, (unit,) * channels)


def _judged(header: StreamHeader) -> Source:
    name = header.identity.sensor
    source = judge(name, f"{name}-id", header)
    assert source is not None
    return source


@pytest.mark.parametrize(
    ("labels", "taken"),
    [
        (("infrared", "red", "green"), 0),
        (("ambient", "infrared", "red"), 1),
        (("LED1", "Ambient"), 0),
        (("Ambient",), 0),
    ],
)
def test_a_pulse_is_not_looked_for_in_ambient_light(labels: tuple[str, ...], taken: int) -> None:
    core = CoreFields("Lamp", "PPG", "lamp", "host", len(labels), 64, ChannelFormat.FLOAT32)
    header = foreign_header(core, labels, ("counts",) * len(labels))
    signal, beats = signals.pulse(64, 20)
    values = np.zeros((len(signal), len(labels)))
    values[:, taken] = signal
    events = _judged(header).new_computer().take(np.arange(len(signal)) / 64, values)
    assert len(signals.stamps_of(events, "beats")) == pytest.approx(len(beats), abs=3)


@pytest.mark.parametrize(
    ("header", "reason"),
    [
        (_header("GSR", ""), FeatureReason.UNIT),
        (_header("GSR", "kohm"), FeatureReason.UNIT),
        (_header("RR", "bpm", 0), FeatureReason.UNIT),
        (_header("Accelerometer", "deg", channels=3), FeatureReason.UNIT),
        (_header("ECG", rate=0), FeatureReason.RATE),
        (_header("ECG", rate=50), FeatureReason.RATE),
        (_header("GSR", "uS", 3.9), FeatureReason.RATE),
        (_header("ECG", form=ChannelFormat.STRING), FeatureReason.FORMAT),
        (_header("Accelerometer", "g", channels=2), FeatureReason.FORMAT),
    ],
)
def test_a_wrong_or_missing_unit_rate_or_channel_is_one_sentence(
    header: StreamHeader, reason: FeatureReason
) -> None:
    with pytest.raises(FeatureError) as caught:
        judge("ECG Amp 1", "", header)
    assert caught.value.reason is reason
    assert "'ECG Amp 1'" in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("kind", ["ECG", "PPG", "Respiration"])
def test_what_ratios_tell_needs_no_unit(kind: str) -> None:
    source = judge("Amp", "", _header(kind, ""))
    assert source is not None
    assert source.features
    assert source.scale == 1.0


@pytest.mark.parametrize("kind", ["ECG", "PPG", "Respiration"])
@pytest.mark.parametrize("unit", ["\N{MICRO SIGN}V", "%\N{DEGREE SIGN}", "a\nb", "x" * 300])
def test_a_unit_that_no_header_of_ours_has_is_no_hindrance(kind: str, unit: str) -> None:
    source = judge("Amp", "", _header(kind, unit))
    assert source is not None
    for feature in source.features:
        for channel in feature.stream.channels:
            assert channel.unit.isascii()


@pytest.mark.parametrize("header_hz", [100.0, 260.0])
@given(st.lists(st.integers(0, 900), max_size=5))
@settings(max_examples=4, deadline=None)
def test_a_wrong_rate_in_a_header_is_told_and_the_true_one_taken(
    header_hz: float, sizes: list[int]
) -> None:
    beats = signals.regular(72.0, 60.0)
    signal = signals.ecg_of(beats, 130.0, 60.0)[:, np.newaxis]
    stamps = 1000.0 + np.arange(len(signal)) / 130.0
    computer = _judged(_header("ECG", rate=header_hz)).new_computer()
    events: list[Event] = []
    begin = 0
    for end in [*np.cumsum(sizes).tolist(), len(stamps)]:
        events += computer.take(stamps[begin:end], signal[begin:end])
        begin = max(begin, end)
    events += computer.finish()
    # It takes a while until the rate is certain.
    found = np.array([each.stamp for each in events if each.feature == "beats"])
    wanted = 1000.0 + beats[(beats > 25.0) & (beats < 58.0)]
    assert np.abs(found[:, np.newaxis] - wanted).min(axis=0).max() < 0.1
    assert computer.remark() == (
        f"ECG Amp 1: its header says {header_hz:g} Hz, but its samples come at 130 Hz, which is "
        "used"
    )


def test_a_rate_that_is_of_no_use_is_told() -> None:
    computer = _judged(_header("ECG")).new_computer()
    # A sender whose stamps are milliseconds.
    computer.take(1e6 + np.arange(4000) / 0.13, np.ones((4000, 1)))
    assert "samples come at 0.13 Hz; features need 80 to 50000 Hz" in computer.remark()


def test_a_type_that_nothing_is_computed_of_is_passed_over() -> None:
    assert judge("EEG", "", _header("EEG")) is None


def test_units_that_differ_between_axes_are_refused() -> None:
    header = replace(_header("Accelerometer", channels=3), units=("g", "g", "m/s^2"))
    with pytest.raises(FeatureError) as caught:
        judge("acc", "", header)
    assert caught.value.reason is FeatureReason.UNIT


@given(st.text(max_size=40), st.sampled_from(TYPES))
def test_whatever_a_foreign_stream_is_called_the_node_reads_what_comes_out(
    name: str, kind: str
) -> None:
    text = "".join(each for each in name if each.isprintable()) or "amp"
    units = {"GSR": "uS", "RR": "s", "Accelerometer": "g"}
    header = _header(kind, units.get(kind, "mV"), name=text, channels=3)
    source = _judged(header)
    for feature in source.features:
        info = stream_info(source, feature)
        try:
            read = read_header(info.as_xml())
        except SpecError as error:
            pytest.fail(f"{text!r}: {error}")
        assert not read.foreign
        assert read.data_name == feature.stream.data_name
        assert read.units == tuple(str(each.unit) for each in feature.stream.channels)
        assert is_feature(info.as_xml())


def test_the_header_tells_origin_algorithm_version_window_and_delay() -> None:
    source = _judged(_header("ECG"))
    xml = stream_info(source, source.features[1]).as_xml()
    assert "<derived_from>ECG Amp 1</derived_from>" in xml
    assert "<algorithm>Hamilton 2002" in xml
    assert "<version>6</version>" in xml
    assert "<window_s>10.0</window_s>" in xml
    assert "<delay_s>0.3</delay_s>" in xml
    # An interval of at most 2 s, the delay, and a lump of 3 s.
    assert read_header(xml).derived == Derived("ECG Amp 1-id", 5.3)


@pytest.mark.parametrize(
    ("header_hz", "true_hz", "burst"),
    [(520, 130, 1), (520, 130, 73), (1040, 130, 1), (130, 520, 292), (130, 520, 520)],
)
def test_a_rate_that_is_far_off_is_found_before_half_a_minute_is_over(
    header_hz: float, true_hz: float, burst: int
) -> None:
    signal, beats = signals.ecg(true_hz, 60)
    stamps = 1000 + np.arange(len(signal)) / true_hz
    # Samples of a burst have the stamp of its last one.
    stamps = np.repeat(stamps[burst - 1 :: burst], burst)
    rows = signal[: len(stamps), np.newaxis]
    computer = _judged(_header("ECG", rate=header_hz)).new_computer()
    told: list[tuple[float, Event]] = []
    for at in range(0, len(stamps), burst):
        part = slice(at, at + burst)
        told += [
            (float(stamps[at]) - 1000, each) for each in computer.take(stamps[part], rows[part])
        ]
    rates = [(now_s, each.values[0]) for now_s, each in told if each.feature == "hr_live"]
    true_rate = 60 / float(np.diff(beats).mean())
    assert rates[0][0] < 25
    assert [rate for _, rate in rates] == pytest.approx([true_rate] * len(rates), abs=5)
    found = [each.stamp - 1000 for _, each in told if each.feature == "beats"]
    due = [beat for beat in beats if 15 < beat < 45]
    assert all(min(abs(each - beat) for each in found) < 0.05 for beat in due)
    taken = re.search(r"samples come at ([\d.]+) Hz, which is used", computer.remark())
    assert taken
    assert float(taken[1]) == pytest.approx(true_hz, rel=1e-3)


@pytest.mark.parametrize(("rate", "delay_s"), [(4, 0.38), (8, 0.44), (15.625, 0.48), (125, 0.48)])
def test_the_header_of_responses_tells_the_delay_that_was_measured_at_its_rate(
    rate: float, delay_s: float
) -> None:
    # Medians of 222 responses of a real recording, told sample by sample.
    source = _judged(_header("GSR", "uS", rate))
    (responses,) = (each for each in source.features if each.name == "scr")
    assert responses.delay_s == pytest.approx(delay_s, abs=0.06)


@pytest.mark.parametrize("holds", ["", "soon", "nan", "inf", "-1", "0"])
def test_a_feature_that_says_badly_how_long_it_holds_is_shown_as_any_stream(holds: str) -> None:
    source = _judged(_header("ECG"))
    xml = stream_info(source, source.features[1]).as_xml()
    spoilt = re.sub(r"<holds_s>.*</holds_s>", f"<holds_s>{holds}</holds_s>", xml)
    assert read_header(spoilt).derived is None
    assert read_header(spoilt).data_name == "hr_live"


def test_what_comes_of_a_replay_says_so() -> None:
    header = replace(_header("ECG"), replay=Replay("study.xdf", "ECG Amp 1-id", 130.0, 1.0, 5.0))
    source = judge("ECG Amp 1", "replay:0123:ECG Amp 1-id", header)
    assert source is not None
    info = stream_info(source, source.features[0])
    assert info.source_id().startswith("replay:0123:")
    read = read_header(info.as_xml())
    assert read.replay is not None
    assert read.replay.file == "study.xdf"


def test_beats_of_a_device_come_from_its_best_stream_in_any_order() -> None:
    sources = [
        _judged(_header(kind, unit, name="watch"))
        for kind, unit in (("RR", "s"), ("PPG", "a.u."), ("ECG", "mV"))
    ]
    for order in (sources, sources[::-1]):
        taken: Taken = set()
        chosen = choose(order, taken)
        assert [each.header.content_type for each in chosen] == ["ECG", "PPG"]
        assert [each.name for each in chosen[1].features] == ["sqi"]
        assert choose(order, taken) == []


# Streams of other programs that are stamped in bursts have their beats, at the right times.
Array = NDArray[np.float64]
COUNT = 200 * BURST
SHAPES = {
    "bursts": bursts(delays(200)),
    "overlaps": overlaps(delays(200)),
    "a burst is lost": without(bursts(delays(200) / 10), [150 * BURST], BURST),
}


def _steadied(stamps: Array, sizes: list[int]) -> tuple[Array, Array]:
    steady = EvenStamps(NOMINAL_HZ)
    values = np.arange(len(stamps), dtype=np.float64)[:, np.newaxis]
    parts: list[tuple[Array, Array]] = []
    begin = 0
    for size in [*sizes, len(stamps)]:
        end = begin + size
        parts.append(steady.take(stamps[begin:end], values[begin:end]))
        begin = end
    parts.append(steady.finish(1))
    told, kept = (np.concatenate(each) for each in zip(*parts, strict=True))
    # Each sample is passed on once, in its order.
    assert np.array_equal(kept, values)
    return told, kept


@pytest.mark.parametrize("name", SHAPES)
def test_stamps_become_even_and_are_right(name: str) -> None:
    told, _ = _steadied(SHAPES[name], [])
    truth = measured(COUNT)
    if name == "a burst is lost":
        truth = np.delete(truth, slice(150 * BURST, 151 * BURST))
    # Before the first packet has ended, nothing tells of packets.
    late = (told - truth)[BURST:]
    # The earliest of a few packets came a little late, too; what is left is the same for all.
    assert np.ptp(late) < 0.05
    assert abs(np.median(late)) < 0.02
    steps = np.diff(told[BURST:])
    assert np.count_nonzero(steps > 0.1) == (name == "a burst is lost")
    assert np.percentile(np.abs(steps * NOMINAL_HZ - 1), 99) < 0.02


@pytest.mark.parametrize("lost", [0, 200])
def test_a_neat_stream_is_passed_as_it_is(lost: int) -> None:
    stamps = without(measured(COUNT), [2000] if lost else [], lost)
    told, _ = _steadied(stamps, [])
    assert np.array_equal(told, stamps)


@cache
def _whole(name: str) -> Array:
    return _steadied(SHAPES[name], [])[0]


@given(st.sampled_from(list(SHAPES)), st.lists(st.integers(0, 900), max_size=20))
def test_blocks_make_no_difference(name: str, sizes: list[int]) -> None:
    assert np.array_equal(_steadied(SHAPES[name], sizes)[0], _whole(name))


# Which outlet of a stream is received: in one session, one at a time, with one header.
FIRST, SECOND = "uid-1", "uid-2"


class Outlet:
    """Announces a stream, as a resolver's info does, and is what its inlet receives."""

    def __init__(
        self,
        uid: str,
        source_id: str = "strap",
        unit: str = "microvolts",
        kind: str = "ECG",
    ) -> None:
        self._uid, self._source_id, self._kind = uid, source_id, kind
        info = pylsl.StreamInfo("strap", kind, 1, 130.0, "float32", source_id)
        channel = info.desc().append_child("channels").append_child("channel")
        channel.append_child_value("label", "ECG")
        channel.append_child_value("unit", unit)
        self.xml = info.as_xml()
        self.is_gone = self.sends = False
        self._count, self._row = 0, [1.0]
        self.openings = self.closings = 0

    def uid(self) -> str:
        return self._uid

    def source_id(self) -> str:
        return self._source_id

    def type(self) -> str:
        return self._kind

    def name(self) -> str:
        return "strap"

    def hostname(self) -> str:
        return "elsewhere"

    def pull_chunk(self, _timeout: float, _most: int) -> tuple[list[Any], list[float]]:
        if self.is_gone:
            raise util.LostError
        if not self.sends:
            return [], []
        self._count += 1
        return [self._row], [self._count / 130]

    def time_correction(self, _timeout: float) -> float:
        return 0.0

    def close_stream(self) -> None:
        self.closings += 1


class Own(Outlet):
    """One of ours, all of one device."""

    WATCH = DeviceIdentity("watch", "")

    def __init__(self, uid: str, stream: StreamSpec) -> None:
        super().__init__(uid, naming.source_id(self.WATCH, stream.data_name))
        self._row = [1.0] * len(stream.channels)
        assert isinstance(stream.rate, float | int)
        info = pylsl.StreamInfo(
            naming.lsl_name(self.WATCH, stream.data_name),
            stream.content_type.value,
            len(stream.channels),
            stream.rate,
            stream.format.value,
            self.source_id(),
        )
        append_children(info.desc(), describe(stream, self.WATCH, DeviceInfo(model="any")))
        self.xml = info.as_xml()


class Immediate:
    """Runs what it is given at once."""

    def submit(self, work: Callable[..., Any], *arguments: Any, **options: Any) -> Future[Any]:
        future: Future[Any] = Future()
        try:
            future.set_result(work(*arguments, **options))
        except RuntimeError as error:
            future.set_exception(error)
        return future


class Told:
    def __init__(self) -> None:
        self.sources: list[Source] = []
        self.sentences: list[str] = []

    def found(self, source: Source) -> None:
        self.sources.append(source)

    def refused(self, sentence: str) -> None:
        self.sentences.append(sentence)

    def with_beats(self) -> list[str]:
        """The source_ids of the streams of which beats were computed."""
        return [
            each.source_id
            for each in self.sources
            if "beats" in {feature.stream.data_name for feature in each.features}
        ]


class Watched:
    """Features of streams that a test announces."""

    def __init__(self) -> None:
        self.told, self.now = Told(), 0.0
        self.live = Live(self.told, lambda: self.now)
        self.live._asking = Immediate()  # type: ignore[assignment]

    def see(self, *outlets: Outlet, seconds: float = 2 * SETTLED_S) -> None:
        """Have these announced for so long."""
        for _ in range(3):
            self.now += seconds / 3
            self.live.look(cast("Sequence[pylsl.StreamInfo]", outlets))
            self.live.read()


@pytest.fixture
def watched(monkeypatch: pytest.MonkeyPatch) -> Watched:
    def opened(info: Any, _limit_s: float, _buffer_s: int, *, as_numpy: bool) -> Any:
        assert not as_numpy
        info.openings += 1
        if info.is_gone:
            raise util.TimeoutError
        return info

    monkeypatch.setattr(inlet_module, "open_inlet", opened)

    def described(info: Outlet) -> str:
        return info.xml

    def sender(_source: Source) -> object:
        return object()

    monkeypatch.setattr(live_module, "_description", described)
    monkeypatch.setattr(live_module, "Sender", sender)
    return Watched()


def test_a_stream_that_comes_back_is_gone_on_with(watched: Watched) -> None:
    first, second = Outlet(FIRST), Outlet(SECOND)
    watched.see(first)
    first.is_gone = True
    watched.see(first)
    watched.see(second)
    assert len(watched.told.sources) == 1
    assert (second.openings, second.closings) == (1, 0)


def test_the_same_outlet_is_opened_again_when_its_connection_is_lost(watched: Watched) -> None:
    outlet = Outlet(FIRST)
    watched.see(outlet)
    outlet.is_gone = True
    watched.live.read()
    outlet.is_gone = False
    watched.see(outlet)
    assert outlet.openings == 2
    assert len(watched.told.sources) == 1


def test_another_header_is_another_source(watched: Watched) -> None:
    first, second = Outlet(FIRST), Outlet(SECOND, unit="millivolts")
    watched.see(first)
    watched.see(second)
    assert [each.header.units for each in watched.told.sources] == [
        ("microvolts",),
        ("millivolts",),
    ]
    assert first.closings == 1


def test_of_two_that_live_the_first_stays_and_it_is_said_once(watched: Watched) -> None:
    first, second = Outlet(FIRST), Outlet(SECOND)
    watched.see(first)
    watched.see(first, second, seconds=DUPLICATE_S / 2)
    assert watched.told.sentences == []
    watched.see(first, second, seconds=3 * DUPLICATE_S)
    watched.see(first, second, seconds=3 * DUPLICATE_S)
    (sentence,) = watched.told.sentences
    assert "share the source_id 'strap'" in sentence
    assert second.openings == 0


def test_what_cannot_be_opened_holds_up_no_other_stream(watched: Watched) -> None:
    gone, other = Outlet(FIRST), Outlet(SECOND, source_id="other")
    gone.is_gone = True
    watched.see(gone, other)
    assert [each.source_id for each in watched.told.sources] == ["other"]
    gone.is_gone = False
    watched.see(gone, other)
    watched.see(gone, other)
    assert [each.source_id for each in watched.told.sources] == ["other", "strap"]


def test_what_a_stream_leaves_is_computed_of_another_one_of_its_device(watched: Watched) -> None:
    ecg, pulse = Outlet(FIRST, "ecg"), Outlet(SECOND, "ppg", kind="PPG")
    ecg.is_gone = True
    watched.see(ecg, pulse)
    watched.see(pulse)
    assert {each.source_id for each in watched.told.sources} == {"ppg"}
    data_names = {each.stream.data_name for each in watched.told.sources[-1].features}
    assert {"beats", "hr_live"} <= data_names


def test_streams_of_other_types_may_have_one_source_id(watched: Watched) -> None:
    ecg, pulse, breath = (
        Outlet(FIRST),
        Outlet(SECOND, kind="PPG"),
        Outlet("uid-3", kind="Respiration"),
    )
    ecg.sends = breath.sends = True
    for _ in range(3):
        watched.see(ecg, pulse, breath, seconds=DUPLICATE_S)
    of = {each.header.content_type: each.features for each in watched.told.sources}
    names = {kind: {each.stream.data_name for each in features} for kind, features in of.items()}
    assert "hr_live" in names["ECG"]
    assert "hr_live" not in names.get("PPG", set())
    assert "br_live" in names["Respiration"]
    assert (ecg.openings, ecg.closings) == (1, 0)
    (sentence,) = watched.told.sentences
    assert "hr_live" in sentence
    assert "stream 'strap' of type ECG has the source_id 'strap' and gives them" in sentence


ECG = raw("ecg", ContentType.ECG, channels(Unit.MICROVOLTS, "ecg"), 130)
PPG = raw("ppg", ContentType.PPG, channels(Unit.COUNTS, "green"), 64)


@pytest.mark.parametrize(
    ("sends_not", "sends"),
    [
        (ECG, PPG),
        (MUSE.stream("optics"), MUSE.stream("ppg")),
        (MUSE.stream("ppg"), MUSE.stream("optics")),
    ],
    ids=lambda stream: stream.data_name,
)
def test_what_a_stream_never_sends_is_computed_of_another_one_of_its_device(
    watched: Watched, sends_not: StreamSpec, sends: StreamSpec
) -> None:
    """A Muse 2 has no optics, an Athena no PPG, and each announces both."""
    silent, pulse = Own(FIRST, sends_not), Own(SECOND, sends)
    # Before the device sends anything, nobody knows which of them will.
    for _ in range(3):
        watched.see(silent, pulse, seconds=SILENT_S)
    assert watched.told.with_beats() == []
    pulse.sends = True
    for _ in range(3):
        watched.see(silent, pulse, seconds=SILENT_S)
    assert watched.told.with_beats() == [pulse.source_id()]
    silent.sends = True
    watched.see(silent, pulse, seconds=SILENT_S)
    assert watched.told.with_beats() == [pulse.source_id()]


def test_an_outlet_that_has_the_port_of_another_does_not_describe_it() -> None:
    class Inlet:
        def info(self, _limit_s: float) -> Outlet:
            return Outlet(SECOND)

    inlet = cast("pylsl.StreamInlet", Inlet())
    with pytest.raises(util.LostError):
        read_description(inlet, FIRST, 1.0)
    assert read_description(inlet, SECOND, 1.0).uid() == SECOND
