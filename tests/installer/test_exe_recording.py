"""The installed program records what its virtual sensors send, whatever ends the recording."""

from __future__ import annotations

import json
import os
import subprocess
import threading
import time
from collections.abc import Generator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from biosensor_gateway.recording.recorder.recording_file import summarize
from installer.wine.prefix import Prefix
from tests.rigs.windows.pc import PIPE_ENCODING, WindowsPc
from tests.rigs.windows.program import RunningProgram, lively, lsl_environment, wait_until

pytestmark = [pytest.mark.system, pytest.mark.timeout(900)]

SETTINGS = b'[log]\nlevel = "info"\n# Sensoren von p01\r\n'
FEW = "zephyr,empatica_e4"
RECORDED_S, MOMENT_S, LOG_OFF_S = 20.0, 5.0, 60.0
COMMAND_S, LAST_WORDS_S = 240.0, 2.0
DONE = 0
OF_THE_RECORDER = {
    *("not-recorded", "too-many", "no-footer", "footer-count", "left-out"),
    *("bad-stamps", "backwards", "wrong-clock", "damaged", "missing", "not-closed", "no-header"),
}
"""What no recording may have, though Wine starves fourteen virtual sensors of their time."""


class Said(NamedTuple):
    """What a command said, and its exit code."""

    code: int
    text: str

    @property
    def json(self) -> dict[str, Any]:
        """Of what it printed; warnings, which go to stderr, are in the same pipe."""
        begin = self.text.find("{")
        assert begin >= 0, self.text
        told: dict[str, Any] = json.JSONDecoder().raw_decode(self.text[begin:])[0]
        return told


class Pc(NamedTuple):
    """A PC with the program, and its Wine while programs run there."""

    windows: WindowsPc
    prefix: Prefix

    def gateway(self, *words: str) -> Said:
        """Run a command to its end; under Wine what it leaves running keeps its pipes open."""
        process = self.prefix.start(self.windows.program, *words)
        assert process.stdin is not None
        assert process.stdout is not None
        process.stdin.close()
        pipe = os.dup(process.stdout.fileno())
        process.stdout.close()
        said = bytearray()

        def read() -> None:
            while data := os.read(pipe, 65536):
                said.extend(data)
            os.close(pipe)

        reader = threading.Thread(target=read, daemon=True)
        reader.start()
        code = process.wait(COMMAND_S)
        reader.join(LAST_WORDS_S)
        return Said(code, said.decode(PIPE_ENCODING))

    def host_path(self, file: str) -> Path:
        """Where a file of drive C lies."""
        return self.windows.drive_c / file.removeprefix("C:\\").replace("\\", "/")


@pytest.fixture(scope="module")
def pc(installed: WindowsPc) -> Pc:
    """A Windows that has windows, through which it tells of the session's end."""
    prefix = lively(installed, lsl_environment())
    key = r"HKCU\Software\Wine\Drivers"
    prefix.run("reg", "add", key, "/v", "Graphics", "/d", "null", "/f")
    installed.user_folder.mkdir(parents=True, exist_ok=True)
    (installed.user_folder / "settings.toml").write_bytes(SETTINGS)
    return Pc(installed, prefix)


@contextmanager
def recording(pc: Pc, sensors: str, task: str) -> Generator[tuple[RunningProgram, dict[str, Any]]]:
    """Stream and record; yields the agent, and what `record start` told."""
    folder = pc.windows.user_folder
    options = ("--no-ask", "--simulate", sensors)
    with RunningProgram(pc.prefix, pc.windows.program, folder, *options) as agent:
        ready = pc.gateway("wait-ready", "--timeout", "150")
        assert ready.code == DONE, ready.text
        where = ("--folder", r"C:\recordings", "--participant", "p01", "--task", task)
        begun = pc.gateway("record", "start", "--here", *where, "--json").json
        with ExitStack() as failed:
            # It would go on, and the next test could not begin one.
            failed.callback(pc.gateway, "record", "stop")
            yield agent, begun
            failed.pop_all()


def _is_whole(file: Path) -> bool:
    return summarize(file).is_closed


# LabRecorder's program has 20 s to find a hundred streams, and misses some beside other tests.
@pytest.mark.alone
def test_all_virtual_sensors_are_recorded(pc: Pc) -> None:
    with recording(pc, "all", "all") as (agent, begun):
        assert [each for each in begun["warnings"] if "records instead" in each] == []
        time.sleep(RECORDED_S)
        ended = pc.gateway("record", "stop", "--json").json
        assert pc.gateway("stop").code == DONE
        assert agent.exit_code() == DONE
    file = pc.host_path(begun["file"])
    verdict = ended["verdict"]
    broken = [each for each in verdict["findings"] if each["code"] in OF_THE_RECORDER]
    assert [f"{each['code']} {each['stream']}: {each['text']}" for each in broken] == []
    seen = summarize(file)
    assert seen.is_closed
    assert len(seen.streams) == len(begun["streams"])
    checked = pc.gateway("xdf", "check", begun["file"], "--json").json
    assert len(checked["streams"]) == len(begun["streams"])


def test_a_forced_upgrade_ends_the_recording_first_and_keeps_everything(
    pc: Pc, setup: Path
) -> None:
    with recording(pc, FEW, "upgraded") as (agent, begun):
        time.sleep(MOMENT_S)
        upgraded = pc.prefix.attempt(setup, "/S", "/FORCE=1")
        assert upgraded.returncode == DONE, upgraded.stdout
        assert agent.exit_code() == DONE
    file = pc.host_path(begun["file"])
    assert _is_whole(file)
    assert (pc.windows.user_folder / "settings.toml").read_bytes() == SETTINGS
    # What is installed now goes on from there.
    with recording(pc, FEW, "upgraded") as (_, again):
        assert again["file"] != begun["file"]
        assert pc.gateway("record", "stop").code == DONE


def test_who_logs_off_leaves_a_whole_file(pc: Pc) -> None:
    with recording(pc, FEW, "logoff") as (agent, begun):
        time.sleep(MOMENT_S)
        try:
            pc.prefix.run("wineboot", "--end-session", timeout=LOG_OFF_S)
        except subprocess.TimeoutExpired:
            pc.prefix.run("wineboot", "--end-session", timeout=LOG_OFF_S)
        assert agent.exit_code() == DONE
    wait_until(lambda: _is_whole(pc.host_path(begun["file"])), "the file is closed")
