"""What ``getLicenseInfo`` tells, and what it may look like."""

from __future__ import annotations

import pytest

from biosensor_gateway.devices.emotiv_insight.driver.protocol import Licence, licence


def test_scopes_and_expiry_are_read() -> None:
    told = {"isOnline": True, "license": {"scopes": ["pm", "eeg"], "expired": True}}
    assert licence(told) == Licence(frozenset({"pm", "eeg"}), expired=True)
    assert not licence({"license": {"scopes": ["pm"], "expired": False}}).expired


@pytest.mark.parametrize("told", [None, [], {}, {"license": 7}, {"license": {"scopes": "eeg"}}])
def test_what_is_not_told_is_not_covered(told: object) -> None:
    assert licence(told) == Licence()
