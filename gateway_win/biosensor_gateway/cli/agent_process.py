"""Runs the agent's process for ``run``; separate from the command because its imports are slow."""

from __future__ import annotations

import asyncio
import os
import subprocess
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import AbstractContextManager, AsyncExitStack, ExitStack, nullcontext
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import IO, Any, Self

import structlog
import typer

from biosensor_common.child import Backoff, close_input, ending_in_words, send, wait_or_kill
from biosensor_common.errors import ConfigError, ConfigReason, GatewayError
from biosensor_common.lsl.network import search
from biosensor_common.lsl.predicates import any_of, equals
from biosensor_common.process_limits import END_S, end_within
from biosensor_common.refusal import Refusal, Refusals
from biosensor_gateway.agent.agent import Agent
from biosensor_gateway.agent.control_server import ControlServer
from biosensor_gateway.agent.device_set import ReadSettings
from biosensor_gateway.agent.marker_commands import MARKERS
from biosensor_gateway.agent.single_instance import single_instance
from biosensor_gateway.cli import SEND_FEATURES
from biosensor_gateway.cli.live_table import LiveTable
from biosensor_gateway.cli.options import settings_or_defaults
from biosensor_gateway.cli.output import can_ask, confirm_while_recording
from biosensor_gateway.devices.registry import sensor_title, settings_models
from biosensor_gateway.settings import file as settings_file
from biosensor_gateway.settings.models import GatewaySettings, LogSettings, LslSettings
from biosensor_gateway.settings.places import settings_path, state_folder
from biosensor_gateway.system.child import start_for
from biosensor_gateway.system.console_lines import shows_colours
from biosensor_gateway.system.keep_alive import RESTARTS, await_turn, restart_facts
from biosensor_gateway.system.logs import (
    configure_logs,
    console_relayed,
    end_logs,
    log_to_file_alone,
)
from biosensor_gateway.system.shutdown import until_signalled
from biosensor_gateway.system.windows_console import quick_edit_off

_start_log = structlog.get_logger("biosensor_gateway.cli")


class StartLog:
    """Context manager that opens the log file before the settings are read.

    An exception that leaves the context is logged to the file only: a `GatewayError` as its
    sentence, any other with its traceback. The caller reports it on the console.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._problem: ConfigError | None = None

    def __enter__(self) -> Self:
        try:
            log_to_file_alone(self._folder)
        except ConfigError as error:
            self._problem = error
        return self

    def go_on(self, settings: LogSettings, *, verbose: bool, title: Callable[[str], str]) -> None:
        """Log to the console as well, as the settings say; see `configure_logs`."""
        if self._problem is None:
            try:
                configure_logs(settings, self._folder, verbose=verbose, title=title)
            except ConfigError as error:
                self._problem = error
        if self._problem is not None:
            # Streaming goes on without a log file, but the console must say so.
            configure_logs(settings, None, verbose=verbose, title=title)
            _start_log.warning(str(self._problem))

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._problem is None and isinstance(error, Exception):
            self._note(error)
        end_logs()

    def _note(self, error: Exception) -> None:
        if isinstance(error, typer.Exit | typer.Abort):
            return
        try:
            # The agent may have closed the log already.
            log_to_file_alone(self._folder)
        except ConfigError:
            return
        if isinstance(error, GatewayError):
            _start_log.error(str(error), reason=str(error.reason.value))
        else:
            _start_log.error("the agent failed", exc_info=error)


_log = structlog.get_logger("biosensor_gateway.cli")


def stream(
    settings: Path | None,
    simulate: str,
    faults: Iterable[str],
    *,
    ask: bool | None,
    while_recording: bool,
    features: bool,
    verbose: bool,
) -> None:
    """Stream until the agent is asked to end.

    Parameters
    ----------
    simulate, faults
        Virtual devices instead of the settings' devices, and their faults; see
        `simulated_settings`.
    ask
        Whether to guide a person at the terminal first; None if the settings name no device.
    while_recording
        Whether to start even if a running recording loses sensors by it.

    Raises
    ------
    GatewayError
        If the agent cannot start.
    """
    folder = state_folder()
    with ExitStack() as stack:
        # Before the log file is opened, which belongs to another agent while that one runs.
        unguarded = _claim(stack, folder)
        log = stack.enter_context(StartLog(folder))
        if ask or (ask is None and _is_guide_wanted(settings, simulate)):
            simulate = _guided(settings or settings_path())
        read = None if simulate else _reader(settings)
        loaded = read() if read else stack.enter_context(_virtual(simulate, faults, settings))
        lost = confirm_start(loaded, folder, may_ask=ask is not False, confirmed=while_recording)
        _run_agent(loaded, read, log, [unguarded, lost], features=features, verbose=verbose)


def confirm_start(
    settings: GatewaySettings, folder: Path, *, may_ask: bool, confirmed: bool
) -> ConfigError | None:
    """Ask before a start by which a running recording loses sensors.

    Returns
    -------
    ConfigError
        What it loses, if it is confirmed, or nobody can be asked because a supervisor starts this
        program; None if it loses nothing.

    Raises
    ------
    ConfigError
        ``IN_USE`` if there is no terminal to ask at.
    typer.Exit
        With code 2 if the person declines.
    """
    from biosensor_gateway.recording.recorder.state import lost_by_start  # only then

    sentence = lost_by_start(settings.devices, folder)
    if not sentence:
        return None
    # If nobody attends, refusing would take the other sensors from the recording, too.
    is_unattended = RESTARTS in os.environ and not (may_ask and can_ask())
    if not (confirmed or is_unattended or restart_facts(os.environ)):
        confirm_while_recording(
            sentence,
            ["Do not start; set it back first", "Start without it all the same"],
            may_ask=may_ask,
        )
    return ConfigError(ConfigReason.IN_USE, sentence)


def stand_by(simulate: str) -> None:
    """Import everything, then wait as a spare process until the supervisor needs it.

    It opens nothing before.

    Parameters
    ----------
    simulate
        Virtual devices that will run, as in `run`; empty for the devices of the settings.
    """
    if simulate:
        from biosensor_gateway.demo import virtual_devices  # only on request

        virtual_devices.import_all(simulate.split(","))
    # Looking up each settings model imports its driver.
    dict(settings_models())
    await_turn()


def _is_guide_wanted(settings: Path | None, simulate: str) -> bool:
    # Somebody who names a file or virtual devices needs no guide.
    if simulate or settings is not None or not can_ask():
        return False
    from biosensor_gateway.cli import devices  # only at a terminal

    return devices.is_wanted(settings_path())


def _guided(path: Path) -> str:
    from biosensor_gateway.cli import devices  # only on request

    return devices.lead(path)


def _reader(path: Path | None) -> ReadSettings:
    # Absolute, because the working directory may change before the file is read again.
    file = (path or settings_path()).absolute()
    return lambda: settings_file.load_settings(file, settings_models())


def _virtual(
    names: str, faults: Iterable[str], settings: Path | None
) -> AbstractContextManager[GatewaySettings]:
    from biosensor_gateway.demo.virtual_devices import simulated_settings  # only on request

    # With virtual devices, too, the LSL section of the settings applies, as for the other programs.
    return simulated_settings(names.split(","), faults, settings_or_defaults(settings))


def _claim(stack: ExitStack, folder: Path) -> ConfigError | None:
    """Lock the folder until the stack unwinds; return why not, if the folder is read-only."""
    try:
        stack.enter_context(single_instance(folder))
    except ConfigError as error:
        if error.reason is ConfigReason.IN_USE:
            raise
        return error
    return None


def _run_agent(
    loaded: GatewaySettings,
    read: ReadSettings | None,
    log: StartLog,
    problems: Sequence[ConfigError | None],
    *,
    features: bool,
    verbose: bool,
) -> None:
    folder = state_folder()
    log.go_on(loaded.log, verbose=verbose, title=sensor_title)
    with quick_edit_off(), console_relayed() as panel:
        unguarded, _ = problems
        for problem in filter(None, problems):
            _log.warning(str(problem))
        if not any(device.enabled for device in loaded.devices):
            _log.warning("no device is enabled in the settings; nothing will be streamed")
        agent = Agent(loaded, folder, read)
        if panel is not None:
            agent.on_status = LiveTable(panel, colours=shows_colours()).report
        controlled = partial(_run_controlled, agent, folder)
        with (
            TwinWatch(agent.refusals_of_devices),
            FeatureProcess(loaded.lsl, agent.refusals) if features else nullcontext() as process,
        ):
            if process is not None:
                agent.on_end = process.end_soon
            asyncio.run(until_signalled(agent.run if unguarded else controlled, code=0))
        if panel is not None:
            panel.close("Ended. Nothing is being streamed.")


async def _run_controlled(agent: Agent, folder: Path) -> None:
    """Run the agent, and end it as a signal would when a client asks for its end."""
    running = asyncio.current_task()
    assert running is not None

    async def stop(_arguments: Mapping[str, Any]) -> Mapping[str, Any]:
        # A second request must not interrupt the closing that the first one has begun.
        if not running.cancelling():
            # liblsl may hang while it destroys an outlet: see docs/liblsl-closing-outlets.md.
            # With exit code 0, because a supervisor would start it again otherwise.
            end_within(code=0)
            running.cancel()
        return {"process": os.getpid()}

    commands = {"stop": stop, **agent.commands}
    async with AsyncExitStack() as stack:
        try:
            server = ControlServer(folder, commands, agent.conversations, looks={MARKERS})
            await stack.enter_async_context(server)
        except ConfigError as error:
            _log.warning(str(error))
        await agent.run()


_TWINS_EVERY_S, _TWINS_FOR_S = 10.0, 1.5


class TwinWatch:
    """Context manager that reports devices which another agent of the LSL session sends, too.

    As with a settings file that was copied: programs would take the streams of either.

    Parameters
    ----------
    refusals
        Returns the refusals of each device by the source_id of its first stream.
    """

    def __init__(self, refusals: Callable[[], Mapping[str, Refusals]]) -> None:
        self._refusals = refusals
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._watch, name="twins", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stopping.set()
        # A search in liblsl must not outlive the interpreter; a daemon, in case it takes longer.
        self._thread.join(_TWINS_FOR_S)

    def _watch(self) -> None:
        while not self._stopping.wait(_TWINS_EVERY_S):
            self.look()

    def look(self) -> None:
        """Search once."""
        refusals = self._refusals()
        wanted = any_of(*(equals("source_id", each) for each in refusals))
        found = search(
            lambda _, passed_s: passed_s > _TWINS_FOR_S or self._stopping.is_set(), wanted
        )
        if self._stopping.is_set():
            return  # nothing is dropped: the agent ends
        outlets = Counter(each.source_id() for each in found)
        for source_id, told in refusals.items():
            told.hold(Refusal.EITHER_SENDER, outlets[source_id] > 1)


class FeatureProcess:
    """Context manager that runs a process for live features, and restarts it when it ends.

    A separate process, so that computing features never delays a sample of the agent. It reads
    the agent's LSL streams like any other program.

    Parameters
    ----------
    refusals
        Gets each of its ends but the last.
    """

    def __init__(self, lsl: LslSettings, refusals: Refusals) -> None:
        self._lsl, self._refusals = lsl, refusals
        self._stopping = threading.Event()
        self._lock = threading.Lock()
        self._process: subprocess.Popen[bytes] | None = None
        self._thread = threading.Thread(target=self._keep, name="features", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def end_soon(self) -> None:
        """Tell the process to end, without waiting for it."""
        with self._lock:
            self._stopping.set()
            if self._process is not None:
                close_input(self._process)

    def __exit__(self, *_: object) -> None:
        self.end_soon()
        process = self._process
        if process is not None:
            wait_or_kill(process, END_S)
        self._thread.join(END_S)

    def _keep(self) -> None:
        backoff = Backoff()
        while not self._stopping.is_set():
            began = time.monotonic()
            ending = self._run_once()
            if self._stopping.is_set():
                return
            delay_s = backoff.next_s(time.monotonic() - began)
            when = f"in {delay_s:g} s" if delay_s else "now"
            self._refusals.refuse(Refusal.FEATURES_ENDED, why=ending)
            _log.warning(f"live features have ended ({ending}) and are started again {when}")
            self._stopping.wait(delay_s)

    def _run_once(self) -> str:
        """Run the process to its end; return how it ended."""
        try:
            process = self._started()
        except OSError as error:
            return f"not started: {error.strerror or error}"
        if process is None:
            return ""
        assert process.stdout is not None
        _log_lines(process.stdout)
        code = process.wait()
        with self._lock:
            close_input(process)
            self._process = None
        return ending_in_words(code)

    def _started(self) -> subprocess.Popen[bytes] | None:
        with self._lock:
            if self._stopping.is_set():
                return None
            # Its input is a pipe that only this process holds open: it ends with its input, so
            # also with an agent that is killed.
            process = start_for([SEND_FEATURES])
            self._process = process
            send(process, f"{self._lsl.model_dump_json(exclude_unset=True)}\n".encode())
            return process


def _log_lines(output: IO[bytes]) -> None:
    with output:
        for line in output:
            _log.info(f"live features {line.decode(errors='replace').strip()}")
