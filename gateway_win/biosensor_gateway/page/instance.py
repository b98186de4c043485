"""Finds the only running page of a state folder, and sends it commands.

The page has a folder in the agent's state folder, with a lock and a control channel like the
agent's. So a second start opens another window of the running page. The address of that window
is valid once; it is in a file only while a browser opens it from there. The server's side is
`reachable`.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import AsyncGenerator, Generator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from biosensor_common.errors import ConfigError, ConfigReason, TransportError, TransportReason
from biosensor_gateway.agent import control
from biosensor_gateway.agent.single_instance import single_instance, wait_until_free
from biosensor_gateway.system.browser import WayIn

if TYPE_CHECKING:
    from biosensor_gateway.agent.control_server import Command

OPEN, END = "open", "end"
ADDRESS, REDIRECT, SETTINGS, IS_SHARED = "address", "redirect", "settings", "shared"
"""Keys of the answer to `OPEN`: an address that opens the page once, the path for a file that
redirects to it (see `WayIn`), the page's settings file, and whether the page is shared with other
computers."""
LOCK_FILE = "page.lock"

_START_S = 30.0
"""How long a page may take to listen on a busy computer."""
_END_S = 15.0
_ASK_AGAIN_S = 0.1


def page_folder(folder: Path) -> Path:
    """Return the folder of the page's lock, control channel and log."""
    return folder / "page"


@contextlib.contextmanager
def only_server(folder: Path) -> Generator[ConfigError | None]:
    """Hold the lock of the page while the context lasts.

    Yields
    ------
    ConfigError or None
        Why other programs cannot find this page, if the folder cannot be written.

    Raises
    ------
    ConfigError
        ``IN_USE`` if another page holds the lock.
    """
    with contextlib.ExitStack() as stack:
        problem: ConfigError | None = None
        try:
            stack.enter_context(single_instance(page_folder(folder), LOCK_FILE))
        except ConfigError as error:
            if error.reason is ConfigReason.IN_USE:
                raise
            problem = error
        yield problem


def ask_for_window(folder: Path) -> dict[str, Any] | None:
    """Return the running page's answer to `OPEN`; None if no page runs.

    Raises
    ------
    GatewayError
        If a page runs and does not answer.
    """
    return _ask(folder, OPEN)


def way_into(running: Mapping[str, Any]) -> WayIn:
    """Return the address in an answer to `OPEN`."""
    return WayIn(str(running[ADDRESS]), str(running.get(REDIRECT, "")))


def ask_to_end(folder: Path) -> bool:
    """End the running page, and wait for its end; return False if no page runs.

    Raises
    ------
    GatewayError
        If the page does not answer, or does not end in time.
    """
    if _ask(folder, END) is None:
        return False
    if not wait_until_free(page_folder(folder), _END_S, LOCK_FILE):
        raise TransportError(TransportReason.BUSY, f"the page has not ended within {_END_S:g} s")
    return True


def _ask(folder: Path, command: str) -> dict[str, Any] | None:
    deadline = time.monotonic() + _START_S
    while True:
        try:
            return control.ask(page_folder(folder), command, lock_file=LOCK_FILE)
        except TransportError as error:
            if error.reason is TransportReason.ABSENT:
                return None
            # A page that is starting holds its lock, but does not listen yet: ask again.
            if time.monotonic() >= deadline:
                message = (
                    "the page is already running and does not answer; end its process, or wait"
                )
                raise TransportError(TransportReason.SILENT, message) from error
        time.sleep(_ASK_AGAIN_S)


@contextlib.asynccontextmanager
async def reachable(
    folder: Path, new_window: Command, end: Command, problem: ConfigError | None
) -> AsyncGenerator[None]:
    """Answer `ask_for_window` and `ask_to_end` while the context lasts."""
    # Imported here, because the commands that only ask a page do not need it.
    import structlog

    from biosensor_gateway.agent.control_server import ControlServer

    commands = {OPEN: new_window, END: end}
    async with contextlib.AsyncExitStack() as stack:
        try:
            server = ControlServer(page_folder(folder), commands, looks=commands)
            await stack.enter_async_context(server)
        except ConfigError as error:
            problem = problem or error
        if problem is not None:
            log = structlog.get_logger("biosensor_gateway.page")
            log.warning("a second page would be a second server", reason=str(problem))
        yield
