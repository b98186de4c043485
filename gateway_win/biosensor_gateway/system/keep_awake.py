"""Keeps the computer from going to sleep by itself while a device streams.

The screen may still go dark, and a closed lid still sends the computer to sleep. How sleep is
prevented:

Windows
    A power request (``PowerCreateRequest``), because ``powercfg /requests`` then shows
    its owner and reason, and because it belongs to the process, not to a thread. On a
    system without power requests, ``SetThreadExecutionState``, which shows no reason.
    On battery, a computer with Modern Standby ends both after a few minutes.
macOS
    ``caffeinate``; ``pmset -g assertions`` shows it.
Linux
    An inhibitor lock of logind through ``systemd-inhibit``; ``systemd-inhibit --list``
    shows it.

All of them end with the agent, even after a crash.

Sources: Microsoft's documentation of ``PowerSetRequest``, the manuals caffeinate(8) and
systemd-inhibit(1).
"""

from __future__ import annotations

import ctypes
import os
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from ctypes import wintypes
from pathlib import Path
from typing import Protocol

import structlog

from biosensor_common import child
from biosensor_common.child import full_path


class ProgramInhibitor:
    """A program that prevents sleep as long as it runs.

    Parameters
    ----------
    command
        The program and its arguments. It must end when its standard input or this
        process ends.
    echoes
        Whether the program writes back its input once it prevents sleep. If it does
        not, it is assumed to prevent sleep as long as it runs.
    """

    def __init__(self, command: Sequence[str], *, echoes: bool) -> None:
        self._command = command
        self._echoes = echoes
        self._answered = False
        self._process: subprocess.Popen[bytes] | None = None

    @property
    def way(self) -> str:
        """Name of the program."""
        return Path(self._command[0]).name

    def begin(self) -> None:
        """Start the program; raises ``OSError`` if it cannot be."""
        self._answered = not self._echoes
        pipe = subprocess.PIPE
        self._process = process = child.start(
            self._command, stdin=pipe, stdout=pipe, stderr=pipe, bufsize=0
        )
        assert process.stdout is not None
        assert process.stderr is not None
        if sys.platform != "win32":  # only for the type checker: Windows uses no program
            os.set_blocking(process.stdout.fileno(), False)
            os.set_blocking(process.stderr.fileno(), False)
        # A program that has ended already is reported by held().
        child.send(process, b"\n")

    def held(self) -> bool:
        """Whether the program prevents sleep; raises ``OSError`` if it has ended."""
        process = self._process
        if process is None:
            return False
        assert process.stdout is not None
        assert process.stderr is not None
        if process.poll() is not None:
            lines = (process.stderr.read() or b"").decode(errors="replace").split("\n")
            last = next((line for line in reversed(lines) if line.strip()), "it ended unexpectedly")
            raise OSError(last.strip())
        if not self._answered:
            self._answered = bool(process.stdout.read(1))
        return self._answered

    def end(self) -> None:
        """End the program."""
        if self._process is not None:
            with self._process as process:
                self._process = None
                process.kill()


if sys.platform == "win32":
    _ES_SYSTEM_REQUIRED = 0x00000001
    _ES_CONTINUOUS = 0x80000000
    _POWER_REQUEST_CONTEXT_VERSION = 0
    _POWER_REQUEST_CONTEXT_SIMPLE_STRING = 0x1
    _POWER_REQUEST_SYSTEM_REQUIRED = 1
    _INVALID_HANDLE = ctypes.c_void_p(-1).value

    class _DetailedReason(ctypes.Structure):
        _fields_ = (
            ("module", wintypes.HMODULE),
            ("reason_id", wintypes.ULONG),
            ("count", wintypes.ULONG),
            ("strings", ctypes.POINTER(wintypes.LPWSTR)),
        )

    class _Reason(ctypes.Union):
        _fields_ = (("detailed", _DetailedReason), ("text", wintypes.LPWSTR))

    class _ReasonContext(ctypes.Structure):
        _fields_ = (
            ("version", wintypes.ULONG),
            ("flags", wintypes.DWORD),
            ("reason", _Reason),
        )

    class WindowsInhibitor:
        """A power request, or the execution state of the calling thread where there is none.

        Parameters
        ----------
        reason
            Owner and reason, as ``powercfg /requests`` shows them.
        """

        def __init__(self, reason: str) -> None:
            self._reason = reason
            self._kernel = ctypes.WinDLL("kernel32", use_last_error=True)
            self._request: int | None = None

        @property
        def way(self) -> str:
            """Name of the method that is used."""
            return "execution state" if self._request is None else "power request"

        def begin(self) -> None:
            """Ask Windows; raises ``OSError`` if it refuses both."""
            try:
                self._request = self._new_request()
            except (AttributeError, OSError) as error:
                # Wine has the functions, but does not implement them.
                _log.debug("no power request", error=str(error))
                self._set_execution_state(_ES_CONTINUOUS | _ES_SYSTEM_REQUIRED)

        def held(self) -> bool:
            """Return True, because Windows answers at once."""
            return True

        def end(self) -> None:
            """Cancel the request or the state."""
            if self._request is None:
                self._set_execution_state(_ES_CONTINUOUS)
            else:
                request, self._request = self._request, None
                # Closing the handle ends the request.
                self._close(request)

        def _new_request(self) -> int:
            create = self._kernel.PowerCreateRequest
            create.argtypes = [ctypes.POINTER(_ReasonContext)]
            create.restype = wintypes.HANDLE
            require = self._kernel.PowerSetRequest
            require.argtypes = [wintypes.HANDLE, ctypes.c_int]
            require.restype = wintypes.BOOL
            context = _ReasonContext(
                _POWER_REQUEST_CONTEXT_VERSION,
                _POWER_REQUEST_CONTEXT_SIMPLE_STRING,
                _Reason(text=self._reason),
            )
            request: int | None = create(ctypes.byref(context))
            if request is None or request == _INVALID_HANDLE:
                raise ctypes.WinError(ctypes.get_last_error())
            if not require(request, _POWER_REQUEST_SYSTEM_REQUIRED):
                error = ctypes.WinError(ctypes.get_last_error())
                self._close(request)
                raise error
            return request

        def _close(self, request: int) -> None:
            close = self._kernel.CloseHandle
            close.argtypes = [wintypes.HANDLE]
            close.restype = wintypes.BOOL
            close(request)

        def _set_execution_state(self, state: int) -> None:
            set_state = self._kernel.SetThreadExecutionState
            set_state.argtypes = [wintypes.DWORD]
            set_state.restype = wintypes.DWORD
            # Returns the previous state, which is never 0; 0 means failure.
            if not set_state(state):
                raise OSError("SetThreadExecutionState refuses")


if sys.platform == "win32":
    from biosensor_gateway.system.keep_awake import WindowsInhibitor

GRACE_S = 60.0
"""How long to stay awake after the last stream, because devices drop out for seconds."""
RETRY_S = 60.0
"""How long to wait after a refusal of the system."""

_WHO = "Biosensor Gateway"
_WHY = "a biosensor is streaming"
_BUS_VARIABLE = "DBUS_SYSTEM_BUS_ADDRESS"
_BUS_SOCKET = Path("/run/dbus/system_bus_socket")

_log = structlog.get_logger("biosensor_gateway.keep_awake")


class Inhibitor(Protocol):
    """A method to prevent sleep."""

    @property
    def way(self) -> str:
        """Name of the method, for the log."""
        ...

    def begin(self) -> None:
        """Send the request to the system; raises ``OSError`` if it refuses at once."""
        ...

    def held(self) -> bool:
        """Whether the system has granted the request; raises ``OSError`` if it has refused."""
        ...

    def end(self) -> None:
        """Cancel the request, also after a refusal."""
        ...


_KEPT = "the computer is kept from sleeping while a device streams"


class KeepAwake:
    """Prevents sleep on request, and for ``GRACE_S`` after the last request.

    A refusal of the system is not raised, but logged once: streaming goes on. All calls
    must come from one thread that lives as long, because Windows keeps the execution
    state per thread. In the agent it is the thread of the event loop.

    Parameters
    ----------
    inhibitor
        How to prevent sleep; ``None`` if it is switched off or impossible.
    clock
        Monotonic time in seconds.
    """

    def __init__(
        self, inhibitor: Inhibitor | None, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._inhibitor = inhibitor
        self._clock = clock
        self._wanted_until = -float("inf")
        self._retry_at = -float("inf")
        self._asked = self._held = self._warned = False

    def hold(self, wanted: bool) -> None:
        """Set whether the computer should stay awake; to be called about once a second."""
        if self._inhibitor is None:
            return
        now = self._clock()
        # First cancel what has expired, then request again. On Windows, a sleep that a person
        # starts ends the power request; its clock counts that sleep, so that the request has
        # expired afterwards and is made again.
        if now >= self._wanted_until:
            self._let_go(self._inhibitor)
        if wanted:
            self._wanted_until = now + GRACE_S
        if now < self._wanted_until:
            self._keep(self._inhibitor, now)

    def close(self) -> None:
        """Let the computer sleep."""
        self._wanted_until = -float("inf")
        if self._inhibitor is not None:
            self._let_go(self._inhibitor)

    def _keep(self, inhibitor: Inhibitor, now: float) -> None:
        try:
            if not self._asked:
                if now < self._retry_at:
                    return
                self._asked = True
                inhibitor.begin()
            held_before, self._held = self._held, inhibitor.held()
            if self._held and not held_before:
                _log.info(_KEPT, way=inhibitor.way, for_people=_KEPT)
        except OSError as error:
            self._take_back(inhibitor)
            self._retry_at = now + RETRY_S
            self._warn(inhibitor, error)

    def _let_go(self, inhibitor: Inhibitor) -> None:
        if self._held:
            _log.info("the computer may go to sleep again")
        if self._asked:
            self._take_back(inhibitor)

    def _take_back(self, inhibitor: Inhibitor) -> None:
        self._asked = self._held = False
        try:
            inhibitor.end()
        except OSError as error:
            _log.debug(
                "the process that kept the computer awake ended with an error", error=str(error)
            )

    def _warn(self, inhibitor: Inhibitor, error: OSError) -> None:
        if not self._warned:
            self._warned = True
            _log.warning(
                "the computer may go to sleep while a device streams; switch off automatic sleep "
                "in the system's settings",
                way=inhibitor.way,
                error=str(error),
            )


def system_inhibitor(platform: str = sys.platform) -> Inhibitor | None:
    """Return the inhibitor of this system; ``None`` if it has none."""
    if sys.platform == "win32":
        return WindowsInhibitor(f"{_WHO}: {_WHY}")
    inhibitor = _caffeinate() if platform == "darwin" else _systemd_inhibit()
    if inhibitor is None:
        _log.debug("nothing on this computer can prevent sleep")
    return inhibitor


def _caffeinate() -> Inhibitor | None:
    program = full_path("caffeinate")
    if program is None:
        return None
    return ProgramInhibitor([program, "-i", "-w", str(os.getpid())], echoes=False)


def _systemd_inhibit() -> Inhibitor | None:
    program = full_path("systemd-inhibit")
    echo = full_path("cat")
    # A container can have the program, but it has no logind.
    if program is None or echo is None:
        return None
    if not (_BUS_VARIABLE in os.environ or _BUS_SOCKET.exists()):
        return None
    command = [program, "--what=sleep:idle", "--mode=block", f"--who={_WHO}", f"--why={_WHY}"]
    # systemd-inhibit runs cat once it has the lock; cat ends with its input, which ends with us.
    return ProgramInhibitor([*command, echo], echoes=True)
