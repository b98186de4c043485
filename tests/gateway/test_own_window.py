"""A window that ends with the program stays until its text was read; who has another is not held.

Whether a console is the program's own only Windows tells; here it is said for it.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest

from biosensor_gateway.system.windows_console import is_own_window
from tests.rigs.terminal import at_terminal

_CODE = """
import sys
from biosensor_gateway import cli
from biosensor_gateway.system import windows_console
windows_console.is_own_window = lambda: True
sys.argv = ["biosensor-gateway", *{arguments!r}]
cli.main()
"""
CLOSE = "Press Enter to close this window."


def program(*arguments: str) -> list[str]:
    return [sys.executable, "-c", _CODE.format(arguments=list(arguments))]


def environment(folder: Path) -> dict[str, str]:
    state = {"BIOSENSOR_GATEWAY_STATE": str(folder / "state"), "TERM": "xterm"}
    return os.environ | state | {"BIOSENSOR_GATEWAY_SETTINGS": str(folder / "settings.toml")}


@pytest.mark.skipif(sys.platform == "win32", reason="there it may be one")
def test_other_systems_have_none() -> None:
    assert not is_own_window()


@pytest.mark.nightly
@pytest.mark.parametrize("typed", ["\n", "\x03", "\x04"], ids=["Enter", "Ctrl-C", "Ctrl-D"])
def test_what_fails_can_be_read(tmp_path: Path, typed: str) -> None:
    (tmp_path / "settings.toml").write_text("[lsl\n")
    with at_terminal(program("run"), environment(tmp_path)) as terminal:
        shown = terminal.until_seen(CLOSE)
        assert "not valid TOML" in " ".join(shown.split())
        terminal.type(typed)
        assert terminal.exit_code() == 2
    assert "Traceback" not in terminal.screen.text


@pytest.mark.nightly
def test_a_double_click_leads(tmp_path: Path) -> None:
    with at_terminal(program(), environment(tmp_path)) as terminal:
        terminal.until_seen("Type a number, then Enter [1]:")
        terminal.type("3\n")
        assert terminal.exit_code() == 0
    assert CLOSE not in terminal.screen.text


@pytest.mark.nightly
def test_what_ends_well_closes(tmp_path: Path) -> None:
    with at_terminal(program("config", "path"), environment(tmp_path)) as terminal:
        assert terminal.exit_code() == 0
    assert CLOSE not in terminal.screen.text
