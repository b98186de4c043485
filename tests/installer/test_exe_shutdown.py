"""However the installed program is asked to end, it stops its devices and exits with 0."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable, Generator
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import pylsl
import pytest

from biosensor_gateway.devices.shimmer3_gsr.simulator import SimulatedShimmer3
from biosensor_gateway.simulation.world import World
from installer.layout import WORK
from installer.wine.prefix import Prefix, windows_path
from tests.empatica_e4.steering import SteeredE4
from tests.faults.expectations import source
from tests.rigs.windows.pc import WindowsPc
from tests.rigs.windows.program import RunningProgram, lively, program_environment, wait_until

pytestmark = [pytest.mark.system, pytest.mark.timeout(600)]

COM = 7
CLOSER = Path(__file__).parents[1] / "rigs" / "windows" / "close_console.py"
STREAMS = {source("empatica_e4", "bvp"), source("shimmer3_gsr", "gsr")}


class Streaming(NamedTuple):
    """The program while it streams from both devices, and where it runs."""

    prefix: Prefix
    pc: WindowsPc
    program: RunningProgram
    folder: Path
    e4: SteeredE4
    shimmer: SimulatedShimmer3


LOG_OFF_S = 60.0
Request = Callable[[Streaming], None]


def _ctrl_c(it: Streaming) -> None:
    it.program.press_ctrl_c()


def _stop_command(it: Streaming) -> None:
    ended = it.prefix.attempt(it.pc.program, "stop")
    assert (ended.returncode, ended.stdout.strip()) == (0, "the agent has ended")


def _log_off(it: Streaming) -> None:
    try:
        it.prefix.run("wineboot", "--end-session", timeout=LOG_OFF_S)
    except subprocess.TimeoutExpired:
        # Wine's own program was once seen to hang before it had told anybody of the end.
        assert it.program.is_running
        it.prefix.run("wineboot", "--end-session", timeout=LOG_OFF_S)


def _close_console(it: Streaming) -> None:
    process = str(it.program.report()["process"])
    it.prefix.run(WORK / "python" / "python.exe", windows_path(CLOSER), process)


@pytest.fixture(scope="module")
def prefix(installed: WindowsPc) -> Prefix:
    """A Windows that has windows: Wine makes none without a display, unless told so."""
    started = lively(installed)
    key = r"HKCU\Software\Wine\Drivers"
    started.run("reg", "add", key, "/v", "Graphics", "/d", "null", "/f")
    return started


@pytest.fixture
def streaming(prefix: Prefix, installed: WindowsPc, tmp_path: Path) -> Generator[Streaming]:
    here = replace(prefix, environment={**prefix.environment, **program_environment(tmp_path)})
    with World() as world, SteeredE4(world) as e4, SimulatedShimmer3(world) as shimmer:
        installed.plug_in(COM, shimmer.port)
        devices = {
            "empatica_e4": e4.settings,
            "shimmer3_gsr": {"port": f"COM{COM}"},
        }
        blocks = [
            "\n".join(
                ["[[device]]", f'sensor = "{name}"', f'unit = "{name.upper()}"']
                + [f"{key} = {json.dumps(value)}" for key, value in fields.items()]
            )
            for name, fields in devices.items()
        ]
        settings = tmp_path / "settings.toml"
        settings.write_text("\n".join(blocks), encoding="utf-8")
        options = ("--settings", windows_path(settings))
        with RunningProgram(here, installed.program, tmp_path, *options) as program:
            for name in devices:
                program.wait_for_state(name, "streaming")
            yield Streaming(here, installed, program, tmp_path, e4, shimmer)


@pytest.mark.parametrize("request_end", [_ctrl_c, _stop_command, _log_off, _close_console])
def test_it_ends_cleanly(streaming: Streaming, request_end: Request) -> None:
    assert streaming.shimmer.streaming
    wait_until(lambda: _found() == STREAMS, "both streams")
    request_end(streaming)
    assert streaming.program.exit_code() == 0, streaming.program.said()
    assert "Traceback" not in streaming.program.said()
    # A Shimmer is never told that its port was closed: it streams on until it is told to stop.
    wait_until(lambda: not streaming.shimmer.streaming, "a Shimmer that was told to stop")
    assert "device_disconnect" in streaming.e4.requests[-1]
    wait_until(lambda: streaming.e4.client_count == 0, "a server without clients")
    left = {each.name for each in streaming.folder.iterdir()}
    assert left == {"settings.toml", "biosensor-gateway.log"}
    wait_until(lambda: not _found(), "no streams")


def _found() -> set[str]:
    return {info.source_id() for info in pylsl.resolve_streams(1.0)} & STREAMS
