"""What may be set for an Insight, and where its headsets may be."""

from __future__ import annotations

from typing import Any

import pytest
from pydantic import ValidationError

from biosensor_gateway.devices.emotiv_insight.driver import (
    DEFAULT_URL,
    EmotivInsightSettings,
    is_loopback,
)
from biosensor_gateway.devices.emotiv_insight.driver.protocol import Licence, licence


def settings(**fields: Any) -> EmotivInsightSettings:
    return EmotivInsightSettings.model_validate({"sensor": "emotiv_insight", "unit": "u", **fields})


def test_the_defaults_just_work() -> None:
    assert settings().url == DEFAULT_URL == "wss://localhost:6868"
    assert (settings().license, settings().headset, settings().allow_remote) == ("", "", False)


def test_no_secret_is_a_setting() -> None:
    assert not [name for name in EmotivInsightSettings.model_fields
                if "client" in name or "secret" in name or "token" in name]  # fmt: skip


def test_every_field_is_described() -> None:
    assert all(field.description for field in EmotivInsightSettings.model_fields.values())


@pytest.mark.parametrize("host", ["localhost", "127.0.0.1", "127.1.2.3", "[::1]"])
def test_this_computer_may_be_the_host(host: str) -> None:
    assert settings(url=f"wss://{host}:6868").url == f"wss://{host}:6868"


@pytest.mark.parametrize("host", ["lab-pc", "192.168.0.7", "localhost.example", "[2001:db8::1]"])
def test_another_computer_must_be_allowed(host: str) -> None:
    with pytest.raises(ValidationError, match="allow_remote"):
        settings(url=f"wss://{host}:6868")
    assert settings(url=f"wss://{host}:6868", allow_remote=True).allow_remote


@pytest.mark.parametrize(
    "url", ["ws://localhost:6868", "localhost", "wss://", "wss://u:p@localhost"]
)
def test_only_a_secured_url_without_a_password_is_one(url: str) -> None:
    with pytest.raises(ValidationError, match="should be like"):
        settings(url=url, allow_remote=True)


def test_a_debit_is_not_negative() -> None:
    assert settings(debit=0).debit == 0
    with pytest.raises(ValidationError):
        settings(debit=-1)


@pytest.mark.parametrize(("host", "loopback"), [("localhost", True), ("::1", True), ("", False)])
def test_loopback_is_told_by_name_or_address(host: str, loopback: bool) -> None:
    assert is_loopback(host) is loopback


def test_scopes_and_expiry_are_read() -> None:
    told = {"isOnline": True, "license": {"scopes": ["pm", "eeg"], "expired": True}}
    assert licence(told) == Licence(frozenset({"pm", "eeg"}), expired=True)
    assert not licence({"license": {"scopes": ["pm"], "expired": False}}).expired


@pytest.mark.parametrize("told", [None, [], {}, {"license": 7}, {"license": {"scopes": "eeg"}}])
def test_what_is_not_told_is_not_covered(told: object) -> None:
    assert licence(told) == Licence()
