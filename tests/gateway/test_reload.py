"""``biosensor-gateway reload``: a real agent, real streams, and settings that change under it."""

from __future__ import annotations

import json
import os
import re
import socket
import subprocess
import sys
from collections.abc import Callable, Generator, Iterable, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pylsl
import pytest

from biosensor_common.errors import ConfigError
from biosensor_gateway.agent import control, status_file
from biosensor_gateway.system.logs import LOG_FILE_NAME
from tests.rigs.gateway import cli_process, inlet, visible
from tests.rigs.polling import wait_until
from tests.rigs.terminal import at_terminal
from tests.rigs.zephyr import SteeredBioHarness

pytestmark = pytest.mark.nightly

ALL_SAMPLES = 1 << 16
RATE_HZ = 250.0


class Outcome(NamedTuple):
    code: int
    out: str
    err: str


class Entry(NamedTuple):
    """A device of the settings file."""

    unit: str
    port: str
    participant: str = ""
    extra: str = ""

    @property
    def table(self) -> str:
        fields = {"sensor": "zephyr", **self._asdict()}
        del fields["extra"]
        lines = [f"{key} = {json.dumps(value)}" for key, value in fields.items() if value]
        return "\n".join(["[[device]]", *lines, self.extra, ""])


@pytest.fixture
def ports() -> Generator[Callable[[int], list[str]]]:
    """Switch virtual devices on; their serial ports."""
    with ExitStack() as stack:
        yield lambda count: [
            stack.enter_context(SteeredBioHarness(seed=seed)).port for seed in range(count)
        ]


@pytest.fixture
def settings(tmp_path: Path) -> Callable[..., Path]:
    """Write the settings file."""

    def written(*entries: Entry, more: str = "") -> Path:
        path = tmp_path / "settings.toml"
        path.write_text(more + "\n".join(entry.table for entry in entries))
        return path

    return written


@pytest.fixture
def reload(tmp_path: Path) -> Callable[[], Outcome]:
    """Call the command as a person does."""

    def called() -> Outcome:
        done = subprocess.run(
            [sys.executable, "-m", "biosensor_gateway.cli", "reload"],
            env=os.environ | {"BIOSENSOR_GATEWAY_STATE": str(tmp_path)},
            capture_output=True,
            text=True,
            check=False,
        )
        return Outcome(done.returncode, done.stdout, done.stderr)

    return called


def devices(folder: Path) -> dict[str, dict[str, Any]]:
    """Return the agent's devices by unit."""
    try:
        return {each["unit"]: each for each in status_file.read_status(folder)["devices"]}
    except ConfigError:
        return {}


def are_streaming(folder: Path, units: Iterable[str]) -> bool:
    known = devices(folder)
    return all(
        unit in known and any(each["pushed"] for each in known[unit]["streams"].values())
        for unit in units
    )


def events(inlet: pylsl.StreamInlet) -> list[dict[str, Any]]:
    texts: list[list[str]] = inlet.pull_chunk(max_samples=ALL_SAMPLES)[0] or []
    return [json.loads(text) for (text,) in texts]


@pytest.mark.seam
def test_what_is_the_same_streams_on_without_a_gap(
    tmp_path: Path,
    unit: str,
    ports: Callable[[int], list[str]],
    settings: Callable[..., Path],
    reload: Callable[[], Outcome],
) -> None:
    several = [Entry(f"{unit[:8]}{index}", port) for index, port in enumerate(ports(8))]
    gone, renamed, *same, new = several
    path = settings(gone, renamed, *same)
    with cli_process(tmp_path, "run", "--settings", str(path), "--no-ask"):
        wait_until(lambda: are_streaming(tmp_path, [each.unit for each in several[:-1]]))
        told = inlet(f"gateway-{socket.gethostname()}-events")
        ecg = {each.unit: inlet(f"zephyr-{each.unit}-ecg") for each in same}
        for reader in ecg.values():
            reader.pull_sample(timeout=10)

        settings(renamed._replace(participant="p07"), *same, new)
        answer = reload()
        assert answer.code == 0, answer.err
        assert answer.out.splitlines() == [
            f"zephyr/{new.unit} was added",
            f"zephyr/{gone.unit} was removed",
            f"zephyr/{renamed.unit} was started again: its entry was changed",
        ]
        wait_until(lambda: are_streaming(tmp_path, [renamed.unit, new.unit]))
        assert list(devices(tmp_path)) == [each.unit for each in (renamed, *same, new)]
        assert devices(tmp_path)[renamed.unit]["participant"] == "p07"
        wait_until(lambda: not visible(f"zephyr-{gone.unit}-ecg"))

        happened = events(told)
        assert not [each for each in happened if each["event"].startswith("gap")]
        changed = {"device_added", "device_removed"}
        assert [(each["event"], each["unit"]) for each in happened if each["event"] in changed] == [
            ("device_removed", gone.unit),
            ("device_removed", renamed.unit),
            ("device_added", renamed.unit),
            ("device_added", new.unit),
        ]
        for entry in same:
            _, stamps = ecg[entry.unit].pull_chunk(max_samples=ALL_SAMPLES)
            assert np.abs(np.diff(stamps) - 1 / RATE_HZ).max() < 0.5 / RATE_HZ
            streams = devices(tmp_path)[entry.unit]["streams"].values()
            assert sum(each["lost"] + each["refused"] for each in streams) == 0
            assert devices(tmp_path)[entry.unit]["connections"] == 1


def test_a_broken_file_changes_nothing_and_is_explained_with_its_line(
    tmp_path: Path,
    unit: str,
    ports: Callable[[int], list[str]],
    settings: Callable[..., Path],
    reload: Callable[[], Outcome],
) -> None:
    (port,) = ports(1)
    entry = Entry(unit, port)
    path = settings(entry)
    with cli_process(tmp_path, "run", "--settings", str(path), "--no-ask"):
        wait_until(lambda: are_streaming(tmp_path, [unit]))
        for extra, line in (("prot = 7", 5), ("port =", 5)):
            settings(entry._replace(extra=extra))
            answer = reload()
            assert answer.code == 1
            assert answer.out == ""
            assert f"line {line}" in answer.err
            assert "Traceback" not in answer.err
        path.unlink()
        assert "there is no settings file" in reload().err
        assert devices(tmp_path)[unit]["connections"] == 1
        assert devices(tmp_path)[unit]["state"] == "streaming"

        settings(entry)
        assert reload().out == "nothing has changed for any device\n"
        settings(entry, more='[lsl]\nsession_id = "other"\n')
        assert "[lsl] holds from the next start" in reload().out
        settings(entry._replace(extra="enabled = false"))
        assert reload().out == f"zephyr/{unit} was removed\n"
        wait_until(lambda: devices(tmp_path) == {})


def test_who_has_withdrawn_stays_so_when_the_entry_comes_back(
    tmp_path: Path,
    unit: str,
    ports: Callable[[int], list[str]],
    settings: Callable[..., Path],
    reload: Callable[[], Outcome],
) -> None:
    (port,) = ports(1)
    path = settings(Entry(unit, port))
    with cli_process(tmp_path, "run", "--settings", str(path), "--no-ask"):
        wait_until(lambda: are_streaming(tmp_path, [unit]))
        pause = [sys.executable, "-m", "biosensor_gateway.cli", "pause", f"zephyr/{unit}"]
        subprocess.run(
            pause, env=os.environ | {"BIOSENSOR_GATEWAY_STATE": str(tmp_path)}, check=True
        )
        settings()
        assert reload().out == f"zephyr/{unit} was removed\n"
        # Or what the status file tells may be of the entry that is gone.
        wait_until(lambda: devices(tmp_path) == {})
        settings(Entry(unit, port))
        assert reload().out == f"zephyr/{unit} was added\n"
        wait_until(lambda: devices(tmp_path).get(unit, {}).get("state") == "streaming")
        wait_until(lambda: devices(tmp_path)[unit]["paused"])
        assert not are_streaming(tmp_path, [unit])


def test_virtual_devices_have_no_file_to_read(
    tmp_path: Path, reload: Callable[[], Outcome]
) -> None:
    with cli_process(tmp_path, "run", "--simulate", "zephyr"):
        wait_until(lambda: devices(tmp_path) != {})
        answer = reload()
        assert (answer.code, answer.out) == (1, "")
        assert "virtual devices, which have no settings file" in answer.err


def test_without_an_agent_it_says_so(reload: Callable[[], Outcome]) -> None:
    answer = reload()
    assert answer.code == 1
    assert answer.err == (
        "biosensor-gateway: no agent is running; start one with: biosensor-gateway run\n"
    )


# ``run`` at a terminal: a table below the log, and plain lines where none can be drawn.

PROGRAM = [sys.executable, "-m", "biosensor_gateway.cli"]
RUN = [*PROGRAM, "run", "--simulate", "zephyr"]
FOOT = "More, in another window: biosensor-gateway status"
STREAMING = re.compile(r"^Zephyr BioHarness 3 +streaming +(\d+\.\d) Hz +\d+ +\d+ %$", re.MULTILINE)
LOG_LINE = re.compile(r"^\d\d:\d\d:\d\d   asked to (?:pause|resume)$", re.MULTILINE)
ESCAPE = "\x1b"


def environment(folder: Path, **changes: str) -> Mapping[str, str]:
    usual = {"BIOSENSOR_GATEWAY_STATE": str(folder), "TERM": "xterm-256color"}
    kept = {key: value for key, value in os.environ.items() if key != "NO_COLOR"}
    return kept | usual | changes


def ask(folder: Path, command: str) -> None:
    control.ask(folder, command, {"device": "zephyr"}, 30.0)


@pytest.mark.seam
def test_a_table_is_renewed_in_place_below_the_log_and_ctrl_c_ends_it(tmp_path: Path) -> None:
    with at_terminal(RUN, environment(tmp_path)) as terminal:
        # Before the device's clock is found, stamps and so the rate may be wrong.
        terminal.until(lambda seen: any(200 < float(hz) < 300 for hz in STREAMING.findall(seen)))
        ask(tmp_path, "pause")
        terminal.until(lambda seen: re.search(r"^Zephyr BioHarness 3 +paused", seen, re.M))
        ask(tmp_path, "resume")
        # A key that is pressed spoils nothing.
        terminal.type("x\n")
        pictures = terminal.screen.pictures
        shown = terminal.until(
            lambda seen: terminal.screen.pictures > pictures + 3 and STREAMING.search(seen)
        )
        assert shown.count(FOOT) == 1
        assert len(STREAMING.findall(shown)) == 1
        logged = [match.start() for match in LOG_LINE.finditer(shown)]
        assert len(logged) == 2
        assert max(logged) < shown.index("Device ")
        terminal.type("\x03")
        assert terminal.exit_code() == 0
    shown = terminal.screen.text
    assert "Device " not in shown
    assert shown.rstrip().endswith("Ended. Nothing is being streamed.")
    # The file has what it always had.
    entries = [json.loads(line) for line in (tmp_path / LOG_FILE_NAME).read_text().splitlines()]
    commands = [each["command"] for each in entries if each["event"] == "a command came"]
    assert commands == ["pause", "resume"]
    assert not [each for each in entries if "for_people" in each]


def test_it_fits_a_window_whose_size_changes(tmp_path: Path) -> None:
    size = {"columns": 46, "lines": 10}
    with at_terminal(RUN, environment(tmp_path), **size) as terminal:
        terminal.until_seen("Press Ctrl-C")
        # Its widest lines were wider.
        terminal.resize(30, 10)
        pictures = terminal.screen.pictures
        terminal.until(lambda _seen: terminal.screen.pictures > pictures + 3)
        terminal.resize(100, 30)
        terminal.until(STREAMING.search)
        pictures = terminal.screen.pictures
        shown = terminal.until(lambda _seen: terminal.screen.pictures > pictures + 3)
        assert len(STREAMING.findall(shown)) == 1
        terminal.type("\x03")
        assert terminal.exit_code() == 0


@pytest.mark.parametrize(
    ("variables", "moves", "colours"),
    [({}, True, True), ({"NO_COLOR": "1"}, True, False), ({"TERM": "dumb"}, False, False)],
    ids=["colours", "NO_COLOR", "dumb"],
)
def test_it_gives_a_terminal_what_that_understands(
    tmp_path: Path, variables: dict[str, str], moves: bool, colours: bool
) -> None:
    with at_terminal(RUN, environment(tmp_path, **variables)) as terminal:
        terminal.until(lambda _seen: (tmp_path / control.CONTROL_FILE).exists())
        ask(tmp_path, "pause")
        terminal.until(lambda seen: "asked to pause" in seen and (FOOT in seen or not moves))
        terminal.type("\x03")
        assert terminal.exit_code() == 0
    assert ("\x1b[J" in terminal.raw) is moves
    assert bool(re.search(r"\x1b\[\d*m", terminal.raw)) is colours
    assert (ESCAPE in terminal.raw) is moves
    assert re.search(r"^\d\d:\d\d:\d\d ! .*paused", terminal.screen.text, re.MULTILINE)


_BEHIND = "import subprocess; raise SystemExit(subprocess.Popen({run!r}, process_group=0).wait())"


def test_it_does_not_draw_while_its_shell_has_put_it_behind(tmp_path: Path) -> None:
    command = [sys.executable, "-c", _BEHIND.format(run=RUN)]
    with at_terminal(command, environment(tmp_path, NO_COLOR="1")) as terminal:
        terminal.until(lambda _seen: (tmp_path / control.CONTROL_FILE).exists())
        ask(tmp_path, "pause")
        terminal.until_seen("asked to pause")
        ask(tmp_path, "stop")
        assert terminal.exit_code() == 0
    assert ESCAPE not in terminal.raw
    assert "Ended. Nothing is being streamed." in terminal.screen.text
