"""Lets other programs of the same user reach the page's server; see `running` for their end."""

from __future__ import annotations

import contextlib
from collections.abc import AsyncGenerator
from pathlib import Path

import structlog

from biosensor_common.errors import ConfigError
from biosensor_gateway.agent.control_server import Command, ControlServer
from biosensor_gateway.page.instance import END, OPEN, page_folder

_log = structlog.get_logger("biosensor_gateway.page")


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
    commands = {OPEN: new_window, END: end}
    async with contextlib.AsyncExitStack() as stack:
        try:
            server = ControlServer(page_folder(folder), commands, looks=commands)
            await stack.enter_async_context(server)
        except ConfigError as error:
            problem = problem or error
        if problem is not None:
            _log.warning("a second page would be a second server", reason=str(problem))
        yield
