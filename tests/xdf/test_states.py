"""What tells of a device was measured before the recording, perhaps long before."""

from __future__ import annotations

import pytest

from biosensor_common.spec import DeviceIdentity
from biosensor_gateway.recording.xdf.findings import Level
from tests.xdf import xdf_file as x
from tests.xdf.checking import check, codes
from tests.xdf.own_streams import own_header

STRAP = DeviceIdentity("polar_h10", "A1B2")
BEGIN_S = 5000.0


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
