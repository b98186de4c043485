"""Whole computers, made of namespaces: no network, no multicast, no way for it, two hosts.

Multicast is tried here, which the tests elsewhere keep away from the network.
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import pytest

from tests.doctor.outlets import Offered, arguments, running
from tests.rigs.hosts.lan import NETWORK, Host, Lan

pytestmark = [pytest.mark.system, pytest.mark.timeout(300)]

_CHOSEN = {"LSLAPICFG", "BIOSENSOR_GATEWAY_SETTINGS", "BIOSENSOR_GATEWAY_STATE"}
_PROGRAM = "from tests.doctor.conftest import program; program()()"
# Nothing but unicast gets in.
_NO_MULTICAST = """table inet office {
    chain arriving {
        type filter hook input priority 0
        meta pkttype { broadcast, multicast } drop
    }
}
"""
_NO_UNICAST = """table inet office {
    chain arriving {
        type filter hook input priority 0
        udp dport 16572-16827 drop
        tcp dport 16572-16827 drop
    }
}
"""
CHECKS = ("interfaces", "discovery", "streams", "lsl_config")


def environment(host: Host, folder: Path) -> dict[str, str]:
    home = folder / host.name
    home.mkdir(exist_ok=True)
    inherited = {name: value for name, value in os.environ.items() if name not in _CHOSEN}
    return inherited | {
        "HOME": str(home),
        "XDG_CONFIG_HOME": str(home),
        "XDG_STATE_HOME": str(home),
    }


def doctor(host: Host, folder: Path) -> dict[str, list[dict[str, Any]]]:
    """Run doctor on a computer; return the findings of each check."""
    only = [part for name in CHECKS for part in ("--only", name)]
    done = subprocess.run(
        host.command(sys.executable, "-c", _PROGRAM, "doctor", "--json", *only),
        env=environment(host, folder),
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.stderr == ""
    content = json.loads(done.stdout)
    print(f"{host.name}: {content['seconds']} s")
    for each in content["findings"]:
        print(f"  {each['level']} {each['check']}: {each['what']}")
        assert not each["what"].startswith("the check")
        assert each["level"] == "ok" or each["fix"]
    assert done.returncode == (0 if content["good"] else 1)
    return {
        name: [each for each in content["findings"] if each["check"] == name] for name in CHECKS
    }


def _offering(host: Host, folder: Path, *streams: Offered) -> AbstractContextManager[None]:
    command = host.command(sys.executable, *arguments("default", streams, "site"))
    return running(command, environment(host, folder))


def levels(findings: list[dict[str, Any]]) -> list[str]:
    return [each["level"] for each in findings]


@pytest.mark.seam
def test_no_network(tmp_path: Path) -> None:
    with Host("lab-pc") as host:
        before = doctor(host, tmp_path)
        write = [sys.executable, "-m", "biosensor_gateway.cli", "config", "lsl"]
        subprocess.run(
            host.command(*write), env=environment(host, tmp_path), check=True, capture_output=True
        )
        after = doctor(host, tmp_path)
    (cause,) = before["interfaces"]
    assert (cause["level"], cause["what"]) == (
        "warning",
        "no network is up, only the loopback",
    )
    assert "biosensor-gateway config lsl" in cause["fix"]
    assert levels(before["discovery"]) == ["ok", "warning"]
    # What it says is what helps.
    assert levels(after["interfaces"]) == ["ok"]
    assert "lsl_api/lsl_api.cfg" in after["lsl_config"][0]["what"]


def test_a_cable_and_the_streams_of_the_other_computer(tmp_path: Path) -> None:
    offered = Offered("good", "good-1"), Offered("bad", "")
    with (
        Lan({"agent-pc": 0, "desk": 5000}) as lan,
        _offering(lan["agent-pc"], tmp_path, *offered),
    ):
        found = doctor(lan["desk"], tmp_path)
    # No default route, and LSL finds its way.
    assert levels(found["interfaces"]) == ["ok", "note"]
    assert "ip route add 224.0.0.0/4 dev eth0" in found["interfaces"][1]["fix"]
    assert f"eth0 ({NETWORK}.2)" in found["interfaces"][0]["what"]
    assert levels(found["discovery"]) == ["ok", "ok"]
    host, empty = found["streams"]
    said = re.fullmatch(r"2 streams on agent-pc: clock offset ([+-][\d.]+) s, .*", host["what"])
    assert said is not None
    assert abs(float(said[1]) - 5000.0) < 0.05
    assert (host["level"], empty["what"]) == ("ok", "without a source_id: bad")


def test_no_multicast(tmp_path: Path) -> None:
    with Lan({"agent-pc": 0, "desk": 0}) as lan:
        desk = lan["desk"]
        desk.run("ip", "route", "add", "default", "via", f"{NETWORK}.1")
        desk.run("nft", "-f", "-", text=_NO_MULTICAST)
        filtered = doctor(desk, tmp_path)
        desk.run("nft", "delete", "table", "inet", "office")
        desk.run("ip", "link", "set", "eth0", "multicast", "off")
        switched_off = doctor(desk, tmp_path)
    assert levels(filtered["interfaces"]) == ["ok", "ok"]
    (unicast, multicast) = filtered["discovery"]
    assert (unicast["level"], multicast["level"]) == ("ok", "warning")
    assert "sudo ufw allow 16571/udp" in multicast["fix"]
    assert switched_off["interfaces"][0]["level"] == "warning"
    assert "ip link set eth0 multicast on" in switched_off["interfaces"][0]["fix"]


def test_a_firewall_on_this_computer_itself(tmp_path: Path) -> None:
    with Lan({"agent-pc": 0}) as lan:
        lan["agent-pc"].run("nft", "-f", "-", text=_NO_UNICAST)
        found = doctor(lan["agent-pc"], tmp_path)
    unicast, multicast = found["discovery"]
    assert (unicast["level"], multicast["level"]) == ("error", "ok")
    assert "16572:16827/tcp" in unicast["fix"]
