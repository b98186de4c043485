"""Records by LabRecorder's window, through its remote control, and checks the file it writes.

The remote control answers ``OK`` to whatever it is told, knows no question, and records every
stream it sees. So whether a recording runs, and whether it was closed, is read from the recording
itself, where it can be reached from this computer.

Facts from App-LabRecorder's ``tcpinterface.cpp`` and ``mainwindow.cpp``: a command is a
line; the reply is ``OK`` without a line end, whatever the command was, and comes when
its work is done. Commands are worked off by the thread of the window, so none is
answered while a message there waits for a click. Some versions lose the second of two
lines that arrive together: a command is sent when the one before was answered.
"""

from __future__ import annotations

import ipaddress
import socket
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import TracebackType
from typing import Self

from biosensor_gateway.recording.participants import (
    OtherParticipantsError,
    compare,
    participant_of,
)
from biosensor_gateway.recording.recorder.live_file import (
    Glance,
    glance,
    grows,
    size_of,
    sizes,
    wait_for_growth,
    wait_until_closed,
)
from biosensor_gateway.recording.recorder.request import Place, Target, choose_target
from biosensor_gateway.recording.recorder.result import (
    By,
    LabRecorderError,
    LabRecorderReason,
    SensorsAwayError,
    Standing,
    Started,
    Stopped,
)
from biosensor_gateway.recording.recorder.state import Remembered, forget, recall, remember
from biosensor_gateway.recording.recorder.streams import Presence, VisibleStream, titles
from biosensor_gateway.recording.xdf.findings import Finding, Level
from biosensor_gateway.system.cloud_folders import warnings_of

DEFAULT_PORT = 22345
CONNECT_S = 5.0
REPLY_S = 30.0
"""``update`` and ``start`` look for streams for a second, ``stop`` closes each of them."""

_REPLY_BYTES = 4096
_OK = "OK"


class RemoteControl:
    """A connection to LabRecorder; a context manager.

    Parameters
    ----------
    host, port
        Where its remote control listens.

    Raises
    ------
    LabRecorderError
        ``UNREACHABLE`` on entering, if nothing listens there.
    """

    def __init__(self, host: str, port: int) -> None:
        self.host, self.port = host, port

    def __enter__(self) -> Self:
        try:
            self._connection = socket.create_connection((self.host, self.port), CONNECT_S)
        except (OSError, UnicodeError) as error:
            # A name with empty or overlong parts is refused before it is looked up.
            why = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
            message = (
                f"LabRecorder's remote control does not answer at {self.host}:{self.port} ({why}); "
                "start LabRecorder there, tick 'EnableRCS', and let TCP through its firewall"
            )
            raise LabRecorderError(LabRecorderReason.UNREACHABLE, message) from error
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._connection.close()

    @property
    def is_local(self) -> bool:
        """Whether it runs on this computer, so that its files are here, too."""
        peer, own = self._connection.getpeername()[0], self._connection.getsockname()[0]
        return peer == own or ipaddress.ip_address(peer.partition("%")[0]).is_loopback

    def command(self, line: str, time_limit_s: float = REPLY_S) -> None:
        """Have one command worked off. That it succeeded is not known afterwards.

        Raises
        ------
        LabRecorderError
            ``NO_REPLY``, ``REFUSED`` or ``UNREACHABLE``.
        """
        where, word = f"LabRecorder at {self.host}:{self.port}", line.partition(" ")[0]
        try:
            self._connection.settimeout(time_limit_s)
            self._connection.sendall(f"{line}\n".encode())
            reply = self._connection.recv(_REPLY_BYTES).decode("utf-8", "replace").strip()
        except TimeoutError:
            message = (
                f"{where} does not answer to {word!r} within {time_limit_s:g} s; look at its "
                "window: a message there may wait for a click"
            )
            raise LabRecorderError(LabRecorderReason.NO_REPLY, message) from None
        except OSError as error:
            message = f"{where} went away at {word!r} ({error.strerror or error}); start it again"
            raise LabRecorderError(LabRecorderReason.UNREACHABLE, message) from error
        if not reply:
            message = f"{where} went away at {word!r}; start it again"
            raise LabRecorderError(LabRecorderReason.UNREACHABLE, message)
        if reply != _OK:
            message = f"{where} answers {reply!r} to {word!r}; is it LabRecorder at all?"
            raise LabRecorderError(LabRecorderReason.REFUSED, message)


GROWTH_S = 30.0
STILL_RECORDS_S = 10.0
"""A recording of one agent writes a block in less."""


@dataclass(frozen=True, slots=True)
class Order:
    """What to record, and what to do about what is not as it should be.

    Attributes
    ----------
    place
        Where to.
    all_streams
        Streams of others are meant to be recorded, too.
    only_ours
        Refuse if there are streams of others.
    allow_missing
        Start although streams are missing.
    without_away
        Start although sensors of the agent do not stream.
    other_participants
        Start although the file is called after somebody else than who wears the sensors.
    growth_s
        How long the file may take to grow.
    """

    place: Place
    all_streams: bool = False
    only_ours: bool = False
    allow_missing: bool = False
    growth_s: float = GROWTH_S
    other_participants: bool = False
    without_away: bool = False

    @property
    def participant(self) -> str:
        """Whose recording the file will say it is; empty if it says nobody."""
        if self.place.labels is not None:
            return self.place.labels.participant
        return "" if self.place.file is None else participant_of(self.place.file)


def start(
    remote: RemoteControl, order: Order, look: Callable[[], Presence], state: Path
) -> Started:
    """Start a recording.

    Parameters
    ----------
    remote
        Connected.
    order
        What to record.
    look
        Looks for the streams there are.
    state
        Folder that keeps what `record stop` and `status` need to know.

    Raises
    ------
    LabRecorderError
        With the reason why nothing was started, or why nobody can say that it was.
    ConfigError
        If `order` makes no sense.
    """
    target = choose_target(order.place, is_local=remote.is_local)
    _require_idle(remote, state)
    _require_free(target)
    presence = look()
    require_sensors(presence, order)
    _require_streams(presence, order)
    require_participant(presence, order)
    warnings = [*_warnings(presence, order)]
    before, begun = sizes(target), time.monotonic()
    for command in ("update", "select all", target.command, "start"):
        if command:
            remote.command(command)
    file = target.files[0] if target.files else None
    kept = Remembered(remote.host, remote.port, str(file or ""), time.time())
    problem = remember(state, kept)
    took_s = 0.0
    if target.folder is None:
        file = None
        warnings.append(_unverified(remote))
    else:
        file = _require_growth(target, before, order.growth_s)
        took_s = time.monotonic() - begun
        # Only now its name is certain.
        problem = remember(state, replace(kept, file=str(file)))
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


def _require_idle(remote: RemoteControl, state: Path) -> None:
    last = recall(state, remote.host, remote.port)
    if last is None or not last.file:
        return
    file = Path(last.file)
    if not glance(file).is_closed and grows(file, STILL_RECORDS_S):
        message = (
            f"LabRecorder is recording already, to {file}; end that with: "
            "biosensor-gateway record stop"
        )
        raise LabRecorderError(LabRecorderReason.RECORDING, message)


def _require_free(target: Target) -> None:
    for file in target.files:
        if file.exists():
            message = (
                f"{file} is there already, and LabRecorder would rename it; choose another name "
                "or run"
            )
            raise LabRecorderError(LabRecorderReason.EXISTS, message)


def what_is_missing(
    presence: Presence, wanted: tuple[VisibleStream, ...], order: Order
) -> str | None:
    """Say why nothing can be recorded of what there is; None if it can.

    Parameters
    ----------
    presence
        The streams there are.
    wanted
        Those of them that are to be recorded.
    """
    if not wanted:
        whose = "of this agent " if presence.visible else ""
        return (
            f"this computer sees no LSL stream {whose}at all, so there is nothing to record; "
            "start an agent with: biosensor-gateway run"
        )
    if presence.missing and not order.allow_missing:
        return (
            f"streams are missing, and what is not there at the start is not recorded: "
            f"{'; '.join(presence.missing)}. Wait for them with: biosensor-gateway wait-ready, or "
            "do without with --allow-missing"
        )
    return None


def require_participant(presence: Presence, order: Order) -> None:
    """Refuse a file that is called after somebody else than who wears the sensors.

    Raises
    ------
    OtherParticipantsError
        Unless `order` confirms it.
    """
    mismatch = compare(order.participant, presence.worn)
    if mismatch is not None and not order.other_participants:
        raise OtherParticipantsError(mismatch)


def require_sensors(presence: Presence, order: Order) -> None:
    """Refuse while a sensor of the agent is paused or does not stream.

    Raises
    ------
    SensorsAwayError
        Unless `order` confirms it.
    """
    if presence.away and not order.without_away:
        raise SensorsAwayError(presence.away)


def _require_streams(presence: Presence, order: Order) -> None:
    message = what_is_missing(presence, presence.visible, order)
    if message is not None:
        raise LabRecorderError(LabRecorderReason.STREAMS_MISSING, message)
    if presence.foreign and order.only_ours:
        message = (
            "LabRecorder records every stream that it sees, and these are not of this agent: "
            f"{titles(presence.foreign)}; end them, or leave out --only-ours"
        )
        raise LabRecorderError(LabRecorderReason.FOREIGN_STREAMS, message)


def recorded_without(what: Sequence[str]) -> Iterator[str]:
    """Name what is missing in a recording that begins all the same."""
    if what:
        yield f"recorded without: {'; '.join(what)}"


def _warnings(presence: Presence, order: Order) -> Iterator[str]:
    yield from recorded_without((*presence.away, *presence.missing))
    if presence.foreign and not order.all_streams:
        yield (
            "started by remote control, LabRecorder records every stream that it sees; these are "
            f"not of this agent: {titles(presence.foreign)}"
        )


def _unverified(remote: RemoteControl) -> str:
    return (
        f"LabRecorder runs on another computer ({remote.host}), and its answer says nothing: look "
        "at its window whether it records, or give --folder, a folder that both computers see"
    )


def _require_growth(target: Target, before: Mapping[Path, int], limit_s: float) -> Path:
    file = wait_for_growth(target, before, limit_s)
    if file is None:
        raise LabRecorderError(LabRecorderReason.NO_GROWTH, _no_growth(target, limit_s))
    return file


def _no_growth(target: Target, limit_s: float) -> str:
    where = target.files[0] if target.files else f"a recording in {target.folder}"
    found = any(sizes(target)) if target.files else False
    what = "is there, but no samples were written to it" if found else "did not appear and grow"
    return (
        f"{where} {what} within {limit_s:g} s, whatever LabRecorder answers. It may be recording "
        "something else already, may not be allowed to write there, or see no streams: look at "
        "its window. Slow streams need longer: --timeout"
    )


STOP_REPLY_S = 60.0
"""Stopping waits up to five seconds for each of its threads."""
STILL_S = 2.0
"""LabRecorder takes in samples twice a second."""
CLOSING_S = 30.0


def stop(remote: RemoteControl, file: Path | None, state: Path) -> Stopped:
    """End the recording.

    Parameters
    ----------
    remote
        Connected.
    file
        The recording as this computer sees it; None for the one that was started
        from here.
    state
        The state folder.

    Raises
    ------
    LabRecorderError
        ``STILL_GROWING`` or ``NOT_CLOSED``, or whatever the remote control brings.
    """
    if file is None:
        last = recall(state, remote.host, remote.port)
        file = Path(last.file) if last is not None and last.file else None
    was_closed = file is not None and glance(file).is_closed
    begun = time.monotonic()
    remote.command("stop", STOP_REPLY_S)
    if file is None:
        forget(state)
        warnings = (_unknown(remote),)
        return Stopped(by=By.WINDOW, verified=False, file=None, verdict=None, warnings=warnings)
    seen = wait_until_closed(file, STILL_S, CLOSING_S)
    if seen is None:
        message = f"{file} still grows {CLOSING_S:g} s after LabRecorder was told to stop"
        raise LabRecorderError(LabRecorderReason.STILL_GROWING, message)
    if not seen.is_closed:
        raise LabRecorderError(LabRecorderReason.NOT_CLOSED, _not_closed(file, seen))
    forget(state)
    warnings = (f"{file} had been closed before",) if was_closed else ()
    return Stopped(
        by=By.WINDOW,
        verified=True,
        file=file,
        bytes=seen.bytes,
        streams=len(seen.streams),
        with_samples=len(seen.with_samples),
        took_s=time.monotonic() - begun,
        verdict=None,
        warnings=warnings,
    )


def _unknown(remote: RemoteControl) -> str:
    where = "on this computer" if remote.is_local else f"on another computer ({remote.host})"
    return (
        f"LabRecorder runs {where}, its answer says nothing, and which file it wrote is not known "
        "here: look at its window whether it stopped, or name the file with --file"
    )


def _not_closed(file: Path, seen: Glance) -> str:
    if not seen.bytes:
        return f"{file} is empty or not there: nothing was recorded to it"
    if not seen.is_whole:
        return (
            f"{file} does not grow any more, but breaks off or is damaged; look at it with: "
            f"biosensor-gateway xdf check {file}"
        )
    open_streams = len(seen.streams - seen.with_footer - seen.without_footer_due)
    return (
        f"{file} does not grow any more, but {open_streams} of its {len(seen.streams)} streams "
        f"were not closed; look at it with: biosensor-gateway xdf check {file}"
    )


_STATUS_GROWTH_S = 10.0
_STATUS_REPLY_S = 10.0
_NO_COMMAND = "status"
"""It knows no question, but answers to every line: so it is alive."""


def standing(host: str, port: int, file: Path | None, state: Path) -> Standing:
    """Look at LabRecorder and at its recording.

    Parameters
    ----------
    host, port
        Of its remote control.
    file
        The recording as this computer sees it; None for the one that was started
        from here.
    state
        The state folder.
    """
    problems: tuple[Finding, ...] = ()
    is_local = None
    try:
        with RemoteControl(host, port) as remote:
            is_local = remote.is_local
            remote.command(_NO_COMMAND, _STATUS_REPLY_S)
    except LabRecorderError as error:
        problems = (Finding(Level.ERROR, error.reason.value, "", str(error)),)
    last = recall(state, host, port)
    if file is None and last is not None and last.file:
        file = Path(last.file)
    known = Standing(
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
    seen = glance(file)
    return replace(
        known,
        recording=False if seen.is_closed else grows(file, _STATUS_GROWTH_S) or None,
        bytes=seen.bytes,
        streams=len(seen.streams),
        with_samples=len(seen.with_samples),
        is_closed=seen.is_closed,
    )
