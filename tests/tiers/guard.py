"""Keeps unit tests from what only a seam or nightly test may use.

The guard watches through Python's audit events, and wraps the few calls that raise none. It
refuses with a sentence; a refusal that the tested code swallows fails the test all the same.
"""

from __future__ import annotations

import asyncio
import ctypes.util
import functools
import os
import platform
import selectors
import sys
import threading
import time
from collections.abc import Callable, Generator
from contextlib import contextmanager
from importlib import import_module
from typing import Any

_LSL = {
    "an LSL outlet": ("lsl_create_outlet", "lsl_create_outlet_ex"),
    "an LSL inlet": ("lsl_create_inlet", "lsl_create_inlet_ex"),
    "an LSL resolver": (
        "lsl_resolve_all",
        "lsl_resolve_byprop",
        "lsl_resolve_bypred",
        "lsl_create_continuous_resolver",
        "lsl_create_continuous_resolver_byprop",
        "lsl_create_continuous_resolver_bypred",
    ),
}
_PROCESS = "a child process"
_EVENTS = {
    "socket.__new__": "a socket",
    "subprocess.Popen": _PROCESS,
    "os.system": _PROCESS,
    "os.exec": _PROCESS,
    "os.fork": _PROCESS,
    "os.forkpty": "a pseudo-terminal",
    "os.posix_spawn": _PROCESS,
    "os.startfile": _PROCESS,
    "pty.spawn": "a pseudo-terminal",
}
_TERMINALS = ("/dev/ptmx", "/dev/pts/", "/dev/tty")
# pytest-timeout waits in a thread where the system has no alarms.
_TIMER_OF_A_HANG = "pytest_timeout"


class NotInUnitTestError(Exception):
    """A unit test used something that takes real time or leaves the process."""


class Guard:
    """Refuses while it is active, in every thread that began after it was installed."""

    def __init__(self) -> None:
        self._test: str | None = None
        self._refusals: list[str] = []
        self._allowed = threading.local()
        self._others = frozenset(
            thread.ident
            for thread in threading.enumerate()
            if thread is not threading.main_thread()
        )

    def install(self) -> None:
        """Watch from now on; once in a process, for audit hooks cannot be removed."""
        # It asks a program on first use, and libraries ask it.
        platform.processor()
        sys.addaudithook(self._audit)
        self._wrap_system()
        self._wrap_libraries()

    def begin(self, test: str) -> None:
        """Refuse from now on, on behalf of this test."""
        self._wrap_libraries()
        self._test = test

    @property
    def is_active(self) -> bool:
        """Whether a unit test is running."""
        return self._test is not None

    def end(self) -> list[str]:
        """Stop refusing and return what was refused since :meth:`begin`."""
        self._test = None
        refusals, self._refusals = self._refusals, []
        return refusals

    @contextmanager
    def allowance(self) -> Generator[None]:
        """Refuse nothing in this thread meanwhile: for the loop's socketpair and virtual time."""
        depth = getattr(self._allowed, "depth", 0)
        self._allowed.depth = depth + 1
        try:
            yield
        finally:
            self._allowed.depth = depth

    def refuse(self, what: str) -> None:
        """Refuse if a unit test runs in this thread.

        Raises
        ------
        NotInUnitTestError
            What the test used, and what to do about it.
        """
        if self._test is None or getattr(self._allowed, "depth", 0):
            return
        thread = threading.current_thread()
        if thread.ident in self._others or thread.name.startswith(_TIMER_OF_A_HANG):
            return
        sentence = (
            f"{self._test} is a unit test and used {what}. Use virtual time, a link in memory or "
            "a fake, or mark the test 'seam' or 'nightly' (tests/README.md)."
        )
        self._refusals.append(sentence)
        raise NotInUnitTestError(sentence)

    def _audit(self, event: str, arguments: tuple[Any, ...]) -> None:
        if self._test is None:
            return
        if what := _EVENTS.get(event):
            self.refuse(what)
        elif event == "import":
            self._wrap_libraries()
        elif event == "open" and str(arguments[0]).startswith(_TERMINALS):
            self.refuse("a terminal")

    def _wrap_system(self) -> None:
        # Asks a program of the system where a library is.
        self._allow(ctypes.util, "find_library")
        for loop in _loops():
            self._allow(loop, "_make_self_pipe")
        for selector in _selectors():
            self._limit(selector, "select", "a wait of an event loop", 1)
        # Of this, Python raises an event only from 3.13 on.
        self._limit(time, "sleep", "time.sleep", 0)
        self._limit(threading.Condition, "wait", "a wait for another thread", 1)
        self._limit(threading.Thread, "join", "a wait for the end of a thread", 1)
        if hasattr(os, "openpty"):
            self._forbid(os, "openpty", "a pseudo-terminal")
        if sys.platform != "win32":
            self._forbid(import_module("_posixsubprocess"), "fork_exec", _PROCESS)

    def _wrap_libraries(self) -> None:
        """Wrap what is imported by now; the guard itself imports none of it."""
        # Each may still be half imported.
        liblsl = getattr(sys.modules.get("pylsl.lib"), "lib", None)
        for what, functions in _LSL.items():
            for function in functions:
                self._forbid(liblsl, function, what)
        context = getattr(sys.modules.get("rclpy.context"), "Context", None)
        self._forbid(context, "init", "a ROS context")

    def _allow(self, owner: Any, name: str) -> None:
        original: Callable[..., Any] | None = getattr(owner, name, None)
        if original is None:
            return

        @functools.wraps(original)
        def allowed(*arguments: Any, **named: Any) -> Any:
            with self.allowance():
                return original(*arguments, **named)

        setattr(owner, name, allowed)

    def _limit(self, owner: Any, name: str, what: str, place: int) -> None:
        """Refuse a call whose ``timeout`` is above zero, by name or as an argument."""
        original: Callable[..., Any] | None = getattr(owner, name, None)
        if original is None:
            return

        @functools.wraps(original)
        def limited(*arguments: Any, **named: Any) -> Any:
            timeout = arguments[place] if len(arguments) > place else named.get("timeout")
            if self._test is not None and timeout is not None and timeout > 0:
                self.refuse(f"{what} of up to {timeout:.3g} s")
            return original(*arguments, **named)

        setattr(owner, name, limited)

    def _forbid(self, owner: Any, name: str, what: str) -> None:
        original: Callable[..., Any] | None = getattr(owner, name, None)
        if original is None or hasattr(original, "_guarded"):
            return

        def forbidden(*arguments: Any, **named: Any) -> Any:
            self.refuse(what)
            return original(*arguments, **named)

        vars(forbidden)["_guarded"] = True
        setattr(owner, name, forbidden)


def _loops() -> list[type]:
    names = {"selector_events": "BaseSelectorEventLoop", "proactor_events": "BaseProactorEventLoop"}
    return [getattr(import_module(f"asyncio.{file}"), name) for file, name in names.items()]


def _selectors() -> list[type]:
    names = ("SelectSelector", "PollSelector", "EpollSelector", "DevpollSelector", "KqueueSelector")
    found = [getattr(selectors, name) for name in names if hasattr(selectors, name)]
    if sys.platform == "win32":
        found.append(asyncio.windows_events.IocpProactor)
    return found


GUARD = Guard()
"""The guard of this process."""
