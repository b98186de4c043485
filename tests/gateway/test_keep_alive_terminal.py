"""An agent that is kept alive at a terminal: whoever has gone is not asked again and again."""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping
from pathlib import Path

import psutil
import pytest

from tests.rigs.terminal import at_terminal

pytestmark = pytest.mark.nightly

RUN = [sys.executable, "-m", "biosensor_gateway.cli", "run", "--keep-alive"]
MENU = "Type a number, then Enter [1]:"


def environment(folder: Path) -> Mapping[str, str]:
    return os.environ | {
        "BIOSENSOR_GATEWAY_STATE": str(folder / "state"),
        "BIOSENSOR_GATEWAY_SETTINGS": str(folder / "settings.toml"),
        "TERM": "xterm",
    }


def test_the_end_of_input_is_no_death(tmp_path: Path) -> None:
    with at_terminal(RUN, environment(tmp_path)) as terminal:
        terminal.until(lambda seen: seen.endswith(MENU))
        terminal.type("\x04")
        assert terminal.exit_code() == 2
    assert "started again" not in terminal.screen.text


def test_a_standby_can_ask_who_sits_there(tmp_path: Path) -> None:
    with at_terminal([*RUN, "--ask"], environment(tmp_path)) as terminal:
        terminal.until(lambda seen: seen.endswith(MENU))
        (supervisor,) = psutil.Process().children()
        terminal.until(lambda _seen: len(supervisor.children()) == 2)
        agent, standby = sorted(supervisor.children(), key=lambda each: each.create_time())
        agent.kill()
        terminal.until(lambda seen: "is started again now" in seen and seen.endswith(MENU))
        assert standby in supervisor.children()
        terminal.type("3\n")
        assert terminal.exit_code() == 0


def test_who_has_chosen_devices_need_not_come_back(tmp_path: Path) -> None:
    settings = tmp_path / "settings.toml"
    settings.write_text('[[device]]\nsensor = "zephyr"\nunit = "B1"\nport = "/dev/no-such-port"\n')
    with at_terminal([*RUN, "--ask"], environment(tmp_path)) as terminal:
        terminal.until(lambda seen: seen.endswith(MENU))
        terminal.type("\n")
        terminal.until_seen("Zephyr BioHarness 3 B1")
        (supervisor,) = psutil.Process().children()
        terminal.until(lambda _seen: len(supervisor.children()) == 2)
        agent, _standby = sorted(supervisor.children(), key=lambda each: each.create_time())
        agent.kill()
        shown = terminal.until_seen("the agent had died and was started again")
        assert shown.count(MENU) == 1
        terminal.type("\x03")
        assert terminal.exit_code() == 0
