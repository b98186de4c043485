"""What tells of a device was measured before the recording, perhaps long before."""

from __future__ import annotations

from dataclasses import replace
from xml.etree import ElementTree as ET

import pytest

from biosensor_common.quantities import ChannelFormat
from biosensor_common.spec import DeviceIdentity
from biosensor_common.stream_header import CoreFields, foreign_header
from biosensor_gateway.features.headers import stream_info
from biosensor_gateway.features.outputs import features_of
from biosensor_gateway.features.sources import judge as judge_source
from biosensor_gateway.recording.xdf.findings import Level
from tests.xdf import xdf_file as x
from tests.xdf.checking import check, codes
from tests.xdf.own_streams import own_header

STRAP = DeviceIdentity("polar_h10", "A1B2")
BEGIN_S = 5000.0
ECG = CoreFields("ecg", "ECG", "id", "host", 1, 130.0, ChannelFormat.FLOAT32)


def _recording(told_s: float, name: str = "bat") -> bytes:
    heart = [BEGIN_S + k for k in range(20)]
    offsets = (BEGIN_S, BEGIN_S + 10, BEGIN_S + 20)
    return x.xdf(
        own_header(1, STRAP, "hr") + x.samples(1, "float32", [[60.0]] * 20, [*heart]),
        own_header(2, STRAP, name) + x.samples(2, "float32", [[90.0]], [told_s]),
        *(
            x.offsets(number, offsets) + x.footer(number, count)
            for number, count in ((1, 20), (2, 1))
        ),
    )


@pytest.mark.parametrize("name", ["bat", "quality"])
@pytest.mark.parametrize("before_s", [10.0, 100.0, 4000.0])
def test_what_a_device_told_before_is_no_error_and_no_begin(before_s: float, name: str) -> None:
    report = check(_recording(BEGIN_S - before_s, name))
    assert codes(report, Level.ERROR) == codes(report, Level.WARNING) == set()
    assert (report.extent.begin, report.extent.end) == (BEGIN_S, BEGIN_S + 19)


def test_one_of_after_it_is_on_another_clock() -> None:
    report = check(_recording(BEGIN_S + 100.0))
    assert {code for code, _ in codes(report, Level.ERROR)} == {"wrong-clock"}


def test_nothing_but_states_is_a_recording_too() -> None:
    content = own_header(1, STRAP, "bat") + x.samples(1, "float32", [[90.0]], [BEGIN_S])
    report = check(x.xdf(content, x.offsets(1, (BEGIN_S + 60, BEGIN_S + 70)), x.footer(1, 1)))
    assert (report.extent.begin, report.extent.end) == (BEGIN_S, BEGIN_S)


@pytest.mark.parametrize(("length_s", "level"), [(20, Level.NOTE), (400, Level.WARNING)])
def test_a_feature_that_looks_back_further_than_the_recording_is_no_fault(
    length_s: int, level: Level
) -> None:
    """The header says how far back; what only qualifies a value may be told by nobody."""
    feature = next(each for each in features_of("ECG", "ecg", "mV") if each.name == "hrv_live")
    source = judge_source("ecg", "id", foreign_header(ECG, ("1",), ("mV",)))
    assert source is not None
    source = replace(source, identity=STRAP)
    root = ET.fromstring(stream_info(source, feature).as_xml())
    labels = [each.label for each in feature.stream.channels]
    stamps = [BEGIN_S + k for k in range(length_s)]
    row = [1.0 if "covered" in label else float("nan") for label in labels]
    header = x.chunk(2, b"\x01\0\0\0" + ET.tostring(root))
    content = x.xdf(
        header,
        x.samples(1, "float32", [row] * length_s, stamps),
        x.offsets(1, (BEGIN_S, BEGIN_S + 10, BEGIN_S + 20)) + x.footer(1, length_s),
    )
    found = [each for each in check(content).findings if each.code == "no-values"]
    assert {each.level for each in found if "RMSSD_300s" in each.text} == {level}
    assert {each.level for each in found if "motion_300s" in each.text} == {Level.NOTE}
