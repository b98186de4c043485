"""Records with LabRecorder's window by remote control, and checks the file that it writes.

The remote control answers ``OK`` to every command, has no queries, and records every stream it
finds. So the file itself shows whether a recording is running or closed, if this computer can
access it.

According to App-LabRecorder's ``tcpinterface.cpp`` and ``mainwindow.cpp``, a command is a line;
the reply is always ``OK`` without a line end, sent when the command has finished. The window's
thread executes the commands, so none is answered while a message there waits for a click. Some
versions lose the second of two lines that arrive together, so each command waits for the previous
reply.
"""

from __future__ import annotations

import ipaddress
import socket
import time
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Self

from biosensor_gateway.recording.recorder.presence import (
    Presence,
    doubles,
    look,
    recorded_without,
    require_startable,
    titles,
)
from biosensor_gateway.recording.recorder.recording_file import (
    FileSummary,
    grows,
    size_of,
    sizes,
    summarize,
    wait_for_growth,
    wait_until_closed,
)
from biosensor_gateway.recording.recorder.request import (
    By,
    RecorderError,
    RecorderReason,
    RecordingRequest,
    Started,
    Status,
    Stopped,
    Target,
    choose_target,
)
from biosensor_gateway.recording.recorder.state import WindowRecording
from biosensor_gateway.recording.xdf.findings import Finding, Level
from biosensor_gateway.settings.models import GatewaySettings
from biosensor_gateway.settings.places import warnings_of

LOCAL_HOST, DEFAULT_PORT = "127.0.0.1", 22345
CONNECT_S = 5.0
REPLY_S = 30.0
"""``update`` and ``start`` search for streams for a second, ``stop`` closes each of them."""
STOP_REPLY_S = 60.0
"""Stopping waits up to five seconds for each of its threads."""
STATUS_REPLY_S = 10.0
GROWS_S = 10.0
"""The recording of one agent writes a block in less time."""
STILL_S = 2.0
"""LabRecorder writes samples twice a second."""
CLOSING_S = 30.0
_REPLY_BYTES = 4096
_OK = "OK"
# It has no such command, but answers every line, which shows that it is running.
_NO_COMMAND = "status"


class RemoteControl:
    """A connection to LabRecorder; a context manager.

    Raises
    ------
    RecorderError
        ``UNREACHABLE`` on entering, if nothing listens there.
    """

    def __init__(self, host: str, port: int) -> None:
        self.host, self.port = host, port

    def __enter__(self) -> Self:
        try:
            self._connection = socket.create_connection((self.host, self.port), CONNECT_S)
        except (OSError, UnicodeError) as error:
            # A host name with empty or overlong parts raises an error before the lookup.
            why = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
            message = (
                f"LabRecorder's remote control does not answer at {self.host}:{self.port} "
                f"({why}); start LabRecorder there, tick 'EnableRCS', and allow TCP in its "
                "firewall"
            )
            raise RecorderError(RecorderReason.UNREACHABLE, message) from error
        return self

    def __exit__(self, *_: object) -> None:
        self._connection.close()

    @property
    def is_local(self) -> bool:
        """Whether it runs on this computer, so its files are here, too."""
        peer, own = self._connection.getpeername()[0], self._connection.getsockname()[0]
        return peer == own or ipaddress.ip_address(peer.partition("%")[0]).is_loopback

    def command(self, line: str, time_limit_s: float = REPLY_S) -> None:
        """Execute one command; whether it succeeded remains unknown.

        Raises
        ------
        RecorderError
            ``NO_REPLY``, ``REFUSED`` or ``UNREACHABLE``.
        """
        where, word = f"LabRecorder at {self.host}:{self.port}", line.partition(" ")[0]
        try:
            self._connection.settimeout(time_limit_s)
            self._connection.sendall(f"{line}\n".encode())
            reply = self._connection.recv(_REPLY_BYTES).decode("utf-8", "replace").strip()
        except TimeoutError:
            message = (
                f"{where} does not answer {word!r} within {time_limit_s:g} s; look at its "
                "window: a message there may be waiting for a click"
            )
            raise RecorderError(RecorderReason.NO_REPLY, message) from None
        except OSError as error:
            message = f"{where} disappeared at {word!r} ({error.strerror or error}); start it again"
            raise RecorderError(RecorderReason.UNREACHABLE, message) from error
        if not reply:
            message = f"{where} disappeared at {word!r}; start it again"
            raise RecorderError(RecorderReason.UNREACHABLE, message)
        if reply != _OK:
            message = f"{where} answers {reply!r} to {word!r}; is it really LabRecorder?"
            raise RecorderError(RecorderReason.REFUSED, message)


class LabRecorder:
    """Recorder with LabRecorder's window, on this computer or another."""

    def __init__(self, host: str, port: int, state: Path) -> None:
        self._host, self._port, self._state = host, port, state

    def start(self, request: RecordingRequest, settings: GatewaySettings) -> Started:
        """Start a recording, and wait until its file grows if this computer can access it.

        Parameters
        ----------
        request
            What to record; since every stream is recorded, `only_ours` fails if there are others.

        Raises
        ------
        RecorderError
            If nothing was started, or the start cannot be verified; see its reason.
        ConfigError
            If `request` is invalid.
        """
        with RemoteControl(self._host, self._port) as remote:
            return self._start(remote, request, settings)

    def _start(
        self, remote: RemoteControl, request: RecordingRequest, settings: GatewaySettings
    ) -> Started:
        target = choose_target(request, is_local=remote.is_local)
        self._require_idle()
        _require_free(target)
        presence = look(settings, self._state)
        require_startable(presence, presence.visible, request)
        _require_no_others(presence, request)
        warnings = [*_warnings(presence, request)]
        before, begun = sizes(target), time.monotonic()
        for command in ("update", "select all", target.command, "start"):
            if command:
                remote.command(command)
        file = target.files[0] if target.files else None
        saved = WindowRecording(self._host, self._port, str(file or ""), time.time())
        problem = saved.save(self._state)
        took_s = 0.0
        if target.folder is None:
            file = None
            warnings.append(
                f"LabRecorder runs on another computer ({self._host}), and its answer does not "
                "tell: check in its window whether it is recording, or give --folder, a folder "
                "that both computers can reach"
            )
        else:
            file = _require_growth(target, before, request.growth_s)
            took_s = time.monotonic() - begun
            # Only now the file's name is certain.
            problem = replace(saved, file=str(file)).save(self._state)
        warnings += [problem] if problem else []
        warnings += warnings_of(file.parent) if file is not None else ()
        return Started(
            by=By.WINDOW,
            verified=file is not None,
            file=file,
            bytes=0 if file is None else size_of(file) or 0,
            took_s=took_s,
            streams=presence.visible,
            foreign=presence.foreign,
            warnings=tuple(warnings),
        )

    def status(self, file: Path | None) -> Status:
        """Return the status of LabRecorder and its recording, as far as known.

        Parameters
        ----------
        file
            Path of the recording on this computer; None for the one started from here.
        """
        problems: tuple[Finding, ...] = ()
        is_local = None
        try:
            with RemoteControl(self._host, self._port) as remote:
                is_local = remote.is_local
                remote.command(_NO_COMMAND, STATUS_REPLY_S)
        except RecorderError as error:
            problems = (Finding(Level.ERROR, error.reason.value, "", str(error)),)
        last = self._last()
        if file is None and last is not None and last.file:
            file = Path(last.file)
        known = Status(
            by=By.WINDOW,
            recording=None,
            file=file,
            started=None if last is None else last.started,
            is_local=is_local,
            answers=not problems,
            problems=problems,
        )
        if file is None:
            return known
        seen = summarize(file)
        return replace(
            known,
            recording=False if seen.is_closed else grows(file, GROWS_S) or None,
            bytes=seen.bytes,
            streams=len(seen.streams),
            with_samples=len(seen.with_samples),
            is_closed=seen.is_closed,
        )

    def stop(self, file: Path | None) -> Stopped:
        """Stop the recording, and wait until its file is closed.

        Parameters
        ----------
        file
            Path of the recording on this computer; None for the one started from here.

        Raises
        ------
        RecorderError
            ``STILL_GROWING`` or ``NOT_CLOSED``, or an error of the remote control.
        """
        with RemoteControl(self._host, self._port) as remote:
            return self._stop(remote, file)

    def _stop(self, remote: RemoteControl, file: Path | None) -> Stopped:
        if file is None:
            last = self._last()
            file = Path(last.file) if last is not None and last.file else None
        was_closed = file is not None and summarize(file).is_closed
        begun = time.monotonic()
        remote.command("stop", STOP_REPLY_S)
        if file is None:
            WindowRecording.forget(self._state)
            warnings = (_unknown(remote),)
            return Stopped(by=By.WINDOW, verified=False, file=None, verdict=None, warnings=warnings)
        seen = wait_until_closed(file, STILL_S, CLOSING_S)
        if seen is None:
            message = f"{file} is still growing {CLOSING_S:g} s after LabRecorder was asked to stop"
            raise RecorderError(RecorderReason.STILL_GROWING, message)
        if not seen.is_closed:
            raise RecorderError(RecorderReason.NOT_CLOSED, _not_closed(file, seen))
        WindowRecording.forget(self._state)
        return Stopped(
            by=By.WINDOW,
            verified=True,
            file=file,
            bytes=seen.bytes,
            streams=len(seen.streams),
            with_samples=len(seen.with_samples),
            took_s=time.monotonic() - begun,
            verdict=None,
            warnings=(f"{file} was already closed",) if was_closed else (),
        )

    def _require_idle(self) -> None:
        last = self._last()
        if last is None or not last.file:
            return
        file = Path(last.file)
        if not summarize(file).is_closed and grows(file, GROWS_S):
            message = (
                f"LabRecorder is already recording, to {file}; end that with: biosensor-gateway "
                "record stop"
            )
            raise RecorderError(RecorderReason.RECORDING, message)

    def _last(self) -> WindowRecording | None:
        return WindowRecording.last_at(self._state, self._host, self._port)


def _require_free(target: Target) -> None:
    for file in target.files:
        if file.exists():
            message = (
                f"{file} already exists, and LabRecorder would rename it; choose another name or "
                "run"
            )
            raise RecorderError(RecorderReason.EXISTS, message)


def _warnings(presence: Presence, request: RecordingRequest) -> Iterator[str]:
    yield from recorded_without((*presence.away, *presence.missing))
    yield from doubles(presence, presence.visible)
    if presence.foreign and not request.all_streams:
        yield (
            "started by remote control, LabRecorder records every stream that it sees; these do "
            f"not belong to this agent: {titles(presence.foreign)}"
        )


def _require_growth(target: Target, before: Mapping[Path, int], limit_s: float) -> Path:
    file = wait_for_growth(target, before, limit_s)
    if file is None:
        raise RecorderError(RecorderReason.NO_GROWTH, _no_growth(target, limit_s))
    return file


def _no_growth(target: Target, limit_s: float) -> str:
    where = target.files[0] if target.files else f"a recording in {target.folder}"
    found = any(sizes(target)) if target.files else False
    what = "exists, but no samples were written to it" if found else "did not appear and grow"
    return (
        f"{where} {what} within {limit_s:g} s, although LabRecorder answers. It may already be "
        "recording something else, may not have permission to write there, or may see no "
        "streams: look at its window. Slow streams need longer: --timeout"
    )


def _unknown(remote: RemoteControl) -> str:
    where = "on this computer" if remote.is_local else f"on another computer ({remote.host})"
    return (
        f"LabRecorder runs {where}, its answer does not tell, and it is not known here which "
        "file it wrote: check in its window whether it stopped, or name the file with --file"
    )


def _not_closed(file: Path, seen: FileSummary) -> str:
    if not seen.bytes:
        return f"{file} is empty or missing: nothing was recorded to it"
    if not seen.is_whole:
        return (
            f"{file} no longer grows, but breaks off or is damaged; look at it with: "
            f"biosensor-gateway xdf check {file}"
        )
    open_streams = len(seen.streams - seen.with_footer - seen.without_footer_due)
    return (
        f"{file} no longer grows, but {open_streams} of its {len(seen.streams)} streams "
        f"were not closed; look at it with: biosensor-gateway xdf check {file}"
    )


def _require_no_others(presence: Presence, request: RecordingRequest) -> None:
    if presence.foreign and request.only_ours:
        message = (
            "LabRecorder records every stream that it sees, and these do not belong to this "
            f"agent: {titles(presence.foreign)}; end them, or leave out --only-ours"
        )
        raise RecorderError(RecorderReason.FOREIGN_STREAMS, message)
