"""Network adapters; what systems with others have is in test_networks.py."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from biosensor_common.doctor import computer, network
from biosensor_common.doctor.check import Finding, Level
from biosensor_common.doctor.network import Interface
from biosensor_gateway.doctor.context import Context
from tests.doctor.conftest import above_ok, only

if TYPE_CHECKING:
    from tests.doctor.conftest import Examine

LO = Interface("lo", ("127.0.0.1",), has_multicast=False)
CABLE = Interface("eth0", ("10.77.0.1",), has_multicast=True)
RADIO = Interface("Wi-Fi", ("192.168.1.20",), has_multicast=True)
DOCKER = Interface("docker0", ("172.17.0.1",), has_multicast=True)

Show = Callable[..., list[Finding]]


@pytest.fixture
def show(examine: Examine, context: Context, monkeypatch: pytest.MonkeyPatch) -> Show:
    """Examine a computer that has these adapters, and multicast goes by that address."""

    def examined(*adapters: Interface, way: str = "") -> list[Finding]:
        monkeypatch.setattr(network, "adapters", lambda: list(adapters))
        monkeypatch.setattr(network, "route", lambda: way)
        return examine(context, "interfaces")

    return examined


@pytest.mark.nightly
def test_this_computer_is_described(examine: Examine, context: Context) -> None:
    assert examine(context, "interfaces")
    assert "127.0.0.1" in [each for one in network.adapters() for each in one.addresses]


@pytest.mark.nightly
def test_a_network_is_all_right(show: Show) -> None:
    found = show(LO, CABLE, way="10.77.0.1")
    assert [each.what for each in found] == [
        "eth0 (10.77.0.1) is up",
        "multicast goes by eth0 (10.77.0.1) first",
    ]
    assert not above_ok(found)


@pytest.mark.nightly
def test_no_network_and_how_to_live_with_it(show: Show, lsl_file: Callable[[str], Path]) -> None:
    lsl_file("")
    (found,) = show(LO)
    assert found.level is Level.WARNING
    assert found.fix.startswith("biosensor-gateway config lsl\n")
    lsl_file("[lab]\nKnownPeers = {127.0.0.1}\n[ports]\nPortRange = 256\n")
    (found,) = show(LO)
    assert found.level is Level.OK


@pytest.mark.nightly
def test_multicast_by_a_virtual_adapter_is_said(show: Show) -> None:
    found = above_ok(show(LO, CABLE, DOCKER, way="172.17.0.1"))
    assert [(each.level, "docker0" in each.what) for each in found] == [
        (Level.NOTE, True),
        (Level.NOTE, True),
    ]


@pytest.mark.nightly
def test_several_networks_are_a_note(show: Show) -> None:
    (found,) = above_ok(show(CABLE, RADIO, way="10.77.0.1"))
    assert (found.level, found.what[:11]) == (Level.NOTE, "2 networks:")


@pytest.mark.nightly
def test_a_cable_between_two_computers_is_a_note(show: Show) -> None:
    found = only(above_ok(show(DOCKER, CABLE)), "prefers no way for multicast")
    assert found.level is Level.NOTE
    assert "224.0.0.0/4 dev eth0" in found.fix


@pytest.mark.parametrize(
    "name",
    [
        "docker0",
        "br-3f2a",
        "veth12ab",
        "virbr0",
        "tun0",
        "wg0",
        "tailscale0",
        "vEthernet (WSL (Hyper-V firewall))",
        "VMware Network Adapter VMnet8",
        "VirtualBox Host-Only Network",
        "Lab VPN",
    ],
)
def test_virtual_adapters_are_known_by_name(name: str) -> None:
    assert Interface(name, ("10.0.0.1",), has_multicast=True).is_virtual


@pytest.mark.parametrize(
    "name", ["eth0", "enp3s0", "wlan0", "wlp2s0", "Ethernet 2", "Wi-Fi", "en0"]
)
def test_real_adapters_are(name: str) -> None:
    assert not Interface(name, ("10.0.0.1",), has_multicast=True).is_virtual


@pytest.mark.parametrize(
    ("name", "level"),
    [("lab-pc", Level.OK), ("Lab PC", Level.WARNING), ("m\u00fcller", Level.WARNING)],
)
def test_names_of_computers(name: str, level: Level) -> None:
    assert computer.judge_name(name).level is level
