"""Virtual devices take part in everything as the settings say, but for the devices."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from biosensor_gateway.cli import agent_process
from biosensor_gateway.demo import demonstration
from biosensor_gateway.settings.models import GatewaySettings

if TYPE_CHECKING:
    from tests.gateway.conftest import Outcome

Run = Callable[..., "Outcome"]

TEXT = """
[lsl]
session_id = "lab7"
known_peers = ["192.168.1.20"]

[log]
level = "warning"

[power]
keep_awake = false

[events]
heartbeat_s = 2.5

[markers]
buttons = ["eyes open"]

[[device]]
sensor = "zephyr"
unit = "1"
port = "/dev/ttyUSB0"
"""


@pytest.fixture
def started(monkeypatch: pytest.MonkeyPatch) -> list[GatewaySettings]:
    """The settings of each agent that would run."""
    settings: list[GatewaySettings] = []

    def note(loaded: GatewaySettings, *_: Any, **__: Any) -> None:
        settings.append(loaded)

    monkeypatch.setattr(agent_process, "_run_agent", note)
    return settings


@pytest.mark.usefixtures("state")
@pytest.mark.parametrize("is_named", [False, True])
def test_all_but_the_devices_is_of_the_settings(
    run: Run, started: list[GatewaySettings], settings: Path, tmp_path: Path, is_named: bool
) -> None:
    file = tmp_path / "other.toml" if is_named else settings
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(TEXT)
    options = ("--settings", str(file)) if is_named else ()
    outcome = run("run", "--no-ask", "--simulate", "polar_h10", *options)
    assert outcome.code == 0, outcome.err
    (loaded,) = started
    assert (loaded.lsl.session_id, loaded.lsl.known_peers) == ("lab7", ("192.168.1.20",))
    assert (loaded.log.level, loaded.power.keep_awake) == ("warning", False)
    assert (loaded.events.heartbeat_s, loaded.markers.buttons) == (2.5, ("eyes open",))
    assert [each.sensor for each in loaded.devices] == ["polar_h10"]


@pytest.mark.usefixtures("state", "settings")
def test_no_settings_are_needed(
    run: Run, started: list[GatewaySettings], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("BIOSENSOR_GATEWAY_LSL__SESSION_ID", "lab8")
    assert run("run", "--no-ask", "--simulate", "polar_h10").code == 0
    assert started[0].lsl.session_id == "lab8"


@pytest.mark.usefixtures("state")
def test_wrong_settings_are_named(run: Run, started: list[GatewaySettings], settings: Path) -> None:
    settings.parent.mkdir(parents=True)
    settings.write_text('[lsl]\nsession = "lab7"\n')
    outcome = run("run", "--no-ask", "--simulate", "polar_h10")
    assert (outcome.code, started) == (2, [])
    assert f"{settings}, line 2" in outcome.err


def test_the_node_of_the_demo_is_in_the_agents_session(settings: Path) -> None:
    settings.parent.mkdir(parents=True)
    settings.write_text(TEXT.replace("lab7", "42"))
    node = demonstration.node_command()
    assert 'session_id:="42"' in node
    assert 'known_peers:=["192.168.1.20"]' in node
