"""Shows agent, page, a recording and its tables with virtual devices, for ``try``."""

from __future__ import annotations

import os
import signal
import socket
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any

from biosensor_common.errors import (
    ConfigError,
    ConfigReason,
    GatewayError,
    TransportError,
    TransportReason,
)
from biosensor_common.lsl.api_file import LOOPBACK
from biosensor_common.naming import lsl_name, source_id
from biosensor_common.process_limits import end_within
from biosensor_common.quantities import waits_for_receivers
from biosensor_gateway.agent.control import stop_agent
from biosensor_gateway.agent.device_states import identity_of
from biosensor_gateway.agent.readiness import wait_until_ready
from biosensor_gateway.agent.status import DeclaredStream, declared_streams
from biosensor_gateway.agent.status_file import running_status
from biosensor_gateway.cli.options import settings_or_defaults
from biosensor_gateway.cli.output import console, say, table_of_names
from biosensor_gateway.demo.demonstration import (
    CHUNK_LENGTH,
    Programs,
    agent_command,
    expected_topics,
    first_devices,
    fitting_devices,
    has_ros,
    node_command,
    show_topics,
    state_of,
    unfilled_streams,
)
from biosensor_gateway.devices.registry import declaration, sensor_title
from biosensor_gateway.page.instance import ask_for_window, ask_to_end, way_into
from biosensor_gateway.recording.contents.choice import Selection
from biosensor_gateway.recording.export.job import Task, export
from biosensor_gateway.recording.export.outcome import sentences
from biosensor_gateway.recording.recorder.local import LocalRecorder
from biosensor_gateway.recording.recorder.request import RecordingRequest
from biosensor_gateway.recording.xdf.findings import Level
from biosensor_gateway.recording.xdf.report_text import finding_lines
from biosensor_gateway.recording.xdf.verdict import Colour, ExpectedStream, Verdict, check
from biosensor_gateway.streaming.room import Room
from biosensor_gateway.system.browser import open_page
from biosensor_gateway.system.child import own_command
from biosensor_gateway.system.shutdown import requests_interrupt

RECORDED_S, _LEAST_RECORDED_S = 10.0, 3.0
_START_S, _READY_S = 600.0, 90.0
"""Limits for a program that is loading, whose end is told at once, and then for its sensors."""
_ASK_S = 0.2
_LOOPBACK_S = 3.0
_LOOK_S = 5.0
_LEAST_TABLE_S = 10.0
_INTERRUPTED, _TELLING_S = "Ended before everything was shown.", 2.0
_TABLES = "csv"
_DOUBLED = "duplicate-source-id"
_SESSION_VARIABLE = "BIOSENSOR_GATEWAY_LSL__SESSION_ID"
_PAGE = "page"


def require_writable(folder: Path) -> None:
    """Check it before everything is started; leave nothing behind.

    Raises
    ------
    ConfigError
        ``UNREADABLE`` if no file can be made in the folder, or the folder not be made.
    """
    made = [each for each in (folder, *folder.parents) if not os.path.lexists(each)]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except OSError as error:
        why = error.strerror or error
        if isinstance(error, FileExistsError):
            why = "it is not a folder"
        message = f"cannot write to {folder}: {why}; choose another --folder"
        raise ConfigError(ConfigReason.UNREADABLE, message) from error
    finally:
        for each in made:
            with suppress(OSError):
                each.rmdir()


def require_loopback() -> None:
    """Check that programs of this computer can talk to each other.

    Raises
    ------
    TransportError
        ``UNAVAILABLE`` if they cannot, as in a container whose loopback interface is down.
    """
    try:
        with (
            socket.create_server((LOOPBACK, 0)) as server,
            socket.create_connection(server.getsockname(), _LOOPBACK_S),
        ):
            pass
    except OSError as error:
        message = (
            f"programs of this computer cannot reach each other at {LOOPBACK} "
            f"({error.strerror or error}); switch its loopback interface on, on Linux with: "
            "ip link set lo up"
        )
        raise TransportError(TransportReason.UNAVAILABLE, message) from error


class Trial:
    """One run of ``try``.

    Parameters
    ----------
    seconds
        How long to run after all sensors stream; None to go on until Ctrl-C.
    """

    def __init__(self, folder: Path, seconds: float | None, *, opens: bool) -> None:
        self._output_folder, self._seconds, self._opens = folder, seconds, opens
        self._recorded_s = min(RECORDED_S, max(_LEAST_RECORDED_S, seconds or RECORDED_S))
        self._settings = settings_or_defaults(None)

    def run(self, *, every: bool) -> int:
        """Show everything; return the exit code of the command.

        Parameters
        ----------
        every
            Whether to run a virtual device of each kind that this computer has room for.

        Raises
        ------
        GatewayError
            If a program does not start or does not answer, or the folder cannot be written.
        """
        require_writable(self._output_folder)
        require_loopback()
        devices, left_out = fitting_devices(Room.here()) if every else (first_devices(), "")
        said: list[str] = []
        with ExitStack() as stack:
            # Once the programs have ended: a terminal that is held with Ctrl-S takes nothing.
            stack.callback(_tell, said)
            work = stack.enter_context(
                tempfile.TemporaryDirectory(prefix="biosensor-try-", ignore_cleanup_errors=True)
            )
            self._work = Path(work)
            self._state = state_of(self._work)
            self._programs = Programs(self._work)
            self._recording = LocalRecorder(self._state)
            stack.callback(signal.signal, signal.SIGINT, signal.getsignal(signal.SIGINT))
            try:
                with requests_interrupt():
                    code = self._show(devices, stack)
            except KeyboardInterrupt:
                said.append(_INTERRUPTED)
                code = 1
            finally:
                # Another Ctrl-C must not keep the programs from being ended.
                signal.signal(signal.SIGINT, signal.SIG_IGN)
                said += self._end_recording()
        if self._output_folder.is_dir():
            say(f"Ended. The recordings stay in {self._output_folder}")
        if left_out:
            say(left_out)
        return code or (1 if left_out else 0)

    def _show(self, devices: Mapping[str, str], stack: ExitStack) -> int:
        names = ", ".join(map(sensor_title, devices))
        say(f"Virtual sensors, no hardware: {names}. They take a moment to start.")
        # Last, an agent that the page has started is asked to end. Our own programs get a signal.
        # Where none ends them in order they are asked before, which takes long if one is stuck.
        stack.callback(_ended, lambda: stop_agent(self._state))
        self._start(stack, "agent", agent_command(devices.values()))
        if sys.platform == "win32":
            stack.callback(_ended, lambda: stop_agent(self._state))
        self._start(stack, _PAGE, own_command(["page", "--no-open"]))
        if sys.platform == "win32":
            stack.callback(_ended, lambda: ask_to_end(self._state))
        if has_ros():
            self._start(stack, "node", node_command())
        self._say_address()
        is_ready = self._wait_until_ready()
        begun = time.monotonic()
        is_good = self._record(devices) and is_ready
        code = self._go_on(devices, begun)
        return code if is_good else 1

    def _start(self, stack: ExitStack, name: str, command: Sequence[str]) -> None:
        stack.enter_context(self._programs.started(name, command))

    def _say_address(self) -> None:
        deadline = time.monotonic() + _START_S
        while (answer := self._ask_for_page()) is None:
            self._programs.require_running()
            if time.monotonic() > deadline:
                message = f"the page has not started within {_START_S:g} s; try it again"
                raise TransportError(TransportReason.SILENT, message)
            time.sleep(_ASK_S)
        way = way_into(answer)
        if self._opens and open_page(way, in_window=False):
            say("The page is open in your browser.")
        else:
            say("Open the page in a browser on this computer; the address works once:")
            say(f"  {way.address}")

    def _ask_for_page(self) -> Mapping[str, Any] | None:
        try:
            return ask_for_window(self._state)
        except TransportError as error:
            # The page is still starting, which takes a while on a busy computer.
            if error.reason is not TransportReason.SILENT:
                raise
            return None

    def _wait_until_ready(self) -> bool:
        deadline, reports = time.monotonic() + _START_S, False
        while True:
            ready = wait_until_ready(self._state, _LOOK_S)
            if ready.devices and not reports:
                deadline, reports = time.monotonic() + _READY_S, True
            if ready.ready:
                say(f"{ready.devices} sensors stream.")
                return True
            self._programs.require_running()
            if time.monotonic() > deadline:
                limit_s = _READY_S if reports else _START_S
                say(f"These do not stream after {limit_s:g} s; the others continue without them:")
                for each in ready.missing:
                    say(f"- {each.sentence}")
                return False

    def _record(self, devices: Mapping[str, str]) -> bool:
        """Make a recording and its tables; return whether no expected stream is missing."""
        status = late_status(self._state, self._programs.require_running)
        expected = [*expected_streams(status, devices, self._recorded_s)]
        request = RecordingRequest(
            self._output_folder, only_ours=True, allow_missing=True, without_away=True
        )
        started = self._recording.start(request, self._settings)
        for warning in started.warnings:
            say(f"! {warning}")
        say(f"Recording for {self._recorded_s:g} s, as the page's button does ...")
        self._wait(time.monotonic() + self._recorded_s)
        file = self._recording.stop().file
        verdict = check(file, expected)
        print_verdict(verdict)
        outcome = export(file, Task([_TABLES], Selection()), _unwatched)
        for sentence in sentences(outcome):
            say(sentence)
        return verdict.colour is not Colour.RED and outcome.is_certain

    def _go_on(self, devices: Mapping[str, str], begun: float) -> int:
        # A person may end both by the page's buttons.
        self._programs.may_end = {"agent", _PAGE}
        until = None if self._seconds is None else begun + self._seconds
        if until is None:
            say("The page continues until you press Ctrl-C here.")
        if has_ros():
            left = None if until is None else max(_LEAST_TABLE_S, until - time.monotonic())
            topics = expected_topics(left, CHUNK_LENGTH, devices)
            shown = {topic: why for topic, why in topics.items() if topic.split("/")[2] in devices}
            return show_topics(left, shown, self._programs, self._work, self._is_over)
        with suppress(KeyboardInterrupt):
            self._wait(until)
        return 0

    def _wait(self, until: float | None) -> None:
        while until is None or time.monotonic() < until:
            self._programs.require_running()
            if self._is_over():
                return
            time.sleep(_ASK_S)

    def _is_over(self) -> bool:
        """Whether the page was ended by its *Quit* button."""
        is_over = self._programs.has_ended(_PAGE)
        if is_over:
            say("The page was ended in the browser.")
        return is_over

    def _end_recording(self) -> Iterator[str]:
        """End a recording that is still running, also one that the page's button started."""
        if self._recording.is_running:
            try:
                file = self._recording.stop().file
            except GatewayError as error:
                yield f"! {error}"
            else:
                yield f"The data recorded so far is in {file}"


def late_status(folder: Path, require_running: Callable[[], object]) -> Mapping[str, Any]:
    """Read the status of the agent, and wait for one that is late on a busy computer.

    Raises
    ------
    ConfigError
        As `running_status`; ``UNREADABLE`` only after `_READY_S`.
    """
    deadline = time.monotonic() + _READY_S
    while True:
        try:
            return running_status(folder)
        except ConfigError as error:
            if error.reason is not ConfigReason.UNREADABLE or time.monotonic() > deadline:
                raise
        require_running()
        time.sleep(_ASK_S)


def _tell(said: Sequence[str]) -> None:
    if _INTERRUPTED in said:
        end_within(_TELLING_S)
    for each in said:
        say(each)


def expected_streams(
    status: Mapping[str, Any], devices: Mapping[str, str], seconds: float
) -> Iterator[ExpectedStream]:
    """Yield the streams that an agent's first recording must have.

    Parameters
    ----------
    devices
        Its virtual devices by sensor, as ``run --simulate`` names them.
    """
    for device in status["devices"]:
        identity = identity_of(device)
        empty = unfilled_streams(devices[identity.sensor], seconds)
        states = {each.data_name for each in declaration(identity.sensor).streams if each.is_state}
        own = [DeclaredStream.model_validate(each) for each in device.get("declared", ())]
        for each in declared_streams(identity.sensor, own):
            # A state that was sent before the recording began may not be sent again while it lasts.
            may_be_empty = waits_for_receivers(
                each.content_type,
                is_regular=each.nominal_hz != 0,
                is_state=each.data_name in states,
            )
            yield ExpectedStream(
                lsl_name(identity, each.data_name),
                source_id(identity, each.data_name),
                must_have_samples=not may_be_empty and each.data_name not in empty,
            )


def print_verdict(verdict: Verdict) -> None:
    """Print a recording's table of streams, its findings, and its verdict."""
    named = sorted(verdict.streams, key=lambda each: each.name)
    rows = [
        (
            each.name,
            str(each.samples),
            str(each.gaps),
            "-" if each.lost is None else str(each.lost),
        )
        for each in named
    ]
    terminal = console()
    terminal.print(table_of_names(("stream", "samples", "gaps", "lost"), rows, terminal.width))
    for line in finding_lines([each for each in verdict.findings if each.level is not Level.NOTE]):
        say(line)
    say(f"{verdict.colour}: {verdict.sentence}")
    if any(each.code == _DOUBLED for each in verdict.findings):
        say(
            "Somebody else in this network tries it at the same time, or runs an agent: those "
            "streams have the same names. For a session of your own, set the environment "
            f"variable {_SESSION_VARIABLE} to a word of yours."
        )
    if verdict.colour is not Colour.RED and not all(each.samples for each in named):
        say(
            "Streams without samples report things that seldom happen, such as a change of the "
            "battery's charge."
        )


def _unwatched(_format: str, _seconds: float) -> Callable[[float], None]:
    return lambda _done: None


def _ended(end: Callable[[], object]) -> None:
    """Ask a program to end; it may have ended already by the same Ctrl-C."""
    with suppress(GatewayError):
        end()
