"""The page's server as other programs of the same user find it: one for each state folder.

It has a folder of its own in the state folder of the agent, with a lock and a control channel like
the agent's. So a second start opens another window of the server that runs, by an address that
is good once and never lies in a file; `reachable` is the server's end.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import AsyncGenerator, Generator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from biosensor_common.errors import ConfigError, ConfigReason, TransportError, TransportReason
from biosensor_gateway.agent import control
from biosensor_gateway.agent.single_instance import single_instance, wait_until_free

if TYPE_CHECKING:
    from biosensor_gateway.agent.control_server import Command

OPEN, END = "open", "end"
ADDRESS, SETTINGS, IS_SHARED = "address", "settings", "shared"
"""What `OPEN` answers: an address that opens the page once, the server's settings file, and
whether other computers can look on."""
LOCK_FILE = "page.lock"

_START_S = 30.0
"""A server of a busy computer may take so long until it listens."""
_END_S = 10.0
_ASK_AGAIN_S = 0.1


def page_folder(folder: Path) -> Path:
    """Where the server keeps lock, control channel and log, below the agent's state folder."""
    return folder / "page"


@contextlib.contextmanager
def only_server(folder: Path) -> Generator[ConfigError | None]:
    """Be the only server of a state folder while the context lasts.

    Yields
    ------
    ConfigError or None
        Why no other server would find this one, where the folder cannot be written.

    Raises
    ------
    ConfigError
        ``IN_USE`` if there is another one.
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
    """Return what `OPEN` answers of the server that runs; None if none does.

    Raises
    ------
    GatewayError
        There is one, and it does not answer.
    """
    return _ask(folder, OPEN)


def ask_to_end(folder: Path) -> bool:
    """End the server that runs, and wait for it; return False if none does.

    Raises
    ------
    GatewayError
        It does not answer, or does not end in time.
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
            # While it starts, it does not listen yet.
            if time.monotonic() >= deadline:
                message = "the page runs already and does not answer; end its process, or wait"
                raise TransportError(TransportReason.SILENT, message) from error
        time.sleep(_ASK_AGAIN_S)


@contextlib.asynccontextmanager
async def reachable(
    folder: Path, new_window: Command, end: Command, problem: ConfigError | None
) -> AsyncGenerator[None]:
    """Let `ask_for_window` and `ask_to_end` reach this server while the context lasts.

    Parameters
    ----------
    folder
        The agent's state folder.
    new_window, end
        What the two ask for.
    problem
        Why no other program will find it; the log says so.
    """
    # Commands ask for the page, and serve nothing.
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
