"""What ``status --watch`` says of what is not passed on: one line, however its count grows."""

from __future__ import annotations

import re

import pytest

from biosensor_gateway.cli.live_table import _Lines  # pyright: ignore[reportPrivateUsage]
from tests.gateway.test_live_table import device, refused, status, stream


def lines(capsys: pytest.CaptureFixture[str]) -> list[str]:
    return [re.sub(r"^\S+ ", "", each) for each in capsys.readouterr().out.splitlines()]


def test_a_line_tells_it_once_while_its_count_grows_and_again_after_it_was_over(
    capsys: pytest.CaptureFixture[str],
) -> None:
    def at(*told: str) -> list[str]:
        heart = stream(2, 100.0, 0.0) | {"refusals": [refused(each) for each in told]}
        view.status(status(device(streams={"polar_h10-A-hr": heart})))
        return lines(capsys)

    view = _Lines()
    assert at() == ["polar_h10 (A1B2C3D4): streaming"]
    assert at("1 sample was not sent: hr was 500") == [
        "polar_h10-A-hr: 1 sample was not sent: hr was 500"
    ]
    assert at("12 samples were not sent: hr was 510") == []
    assert at() == []
    assert at("13 samples were not sent: hr was 510") == [
        "polar_h10-A-hr: 13 samples were not sent: hr was 510"
    ]
