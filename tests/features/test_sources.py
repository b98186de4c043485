"""What a header must say, and what is told of one that does not."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from biosensor_common.errors import SpecError
from biosensor_common.lsl_header import read_header
from biosensor_common.quantities import ChannelFormat
from biosensor_common.replay import Replay
from biosensor_common.stream_header import CoreFields, Derived, StreamHeader, foreign_header
from biosensor_gateway.features.errors import FeatureError, FeatureReason
from biosensor_gateway.features.headers import is_feature, stream_info
from biosensor_gateway.features.outputs import TYPES
from biosensor_gateway.features.sources import Source, Taken, choose, judge
from tests.features import signals


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
    assert "<version>5</version>" in xml
    assert "<window_s>10.0</window_s>" in xml
    assert "<delay_s>0.3</delay_s>" in xml
    # An interval of at most 2 s, the delay, and a lump of 3 s.
    assert read_header(xml).derived == Derived("ECG Amp 1-id", 5.3)


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
