"""``biosensor-gateway page``: shows the agent, or the LSL network, in the browser."""

from __future__ import annotations

import contextlib
import math
import os
from collections.abc import Callable, Generator
from pathlib import Path
from types import TracebackType
from typing import Annotated, Self

import typer

from biosensor_common.errors import ConfigError, ConfigReason, TransportError, TransportReason
from biosensor_common.process_limits import limit_arenas
from biosensor_gateway.cli.options import SettingsOption
from biosensor_gateway.page.instance import (
    IS_SHARED,
    SETTINGS,
    ask_for_window,
    ask_to_end,
    page_folder,
    way_into,
)
from biosensor_gateway.recording.recorder.state import said_to_go_on
from biosensor_gateway.settings.places import settings_path, state_folder
from biosensor_gateway.system.browser import WayIn, open_page

SHARE_PORT = 8719
"""A fixed port, because it has to be opened in firewalls."""


def _checked_minutes(minutes: float) -> float:
    # Written this way round to refuse NaN as well.
    if not minutes >= 0:
        raise typer.BadParameter(f"{minutes:g} is not a time; give minutes, such as 2")
    return minutes


EndAfterOption = Annotated[
    float,
    typer.Option(
        metavar="MINUTES",
        callback=_checked_minutes,
        help="End after this many minutes without a window, an agent and a recording.",
        show_default="never",
    ),
]
ShareOption = Annotated[
    bool,
    typer.Option(
        "--share", help="Other computers can view it over TLS; they cannot change anything."
    ),
]
LslOption = Annotated[
    bool,
    typer.Option(
        "--lsl",
        help="Show the LSL streams that reach this computer, ours and other programs', without an "
        "agent: for the robot's computer.",
    ),
]


def page(
    settings: SettingsOption = None,
    browser: Annotated[
        bool, typer.Option("--open/--no-open", help="Open it in the browser, or print its address.")
    ] = True,
    window: Annotated[
        bool,
        typer.Option("--window", help="Open it in a separate window, if there is Edge or Chrome."),
    ] = False,
    end_after: EndAfterOption = math.inf,
    share: ShareOption = False,
    share_port: Annotated[
        int, typer.Option(min=0, max=65535, help="TCP port for them; 0 for any free port.")
    ] = SHARE_PORT,
    lsl: LslOption = False,
    end: Annotated[
        bool, typer.Option("--end", help="End the running page; the agent continues.")
    ] = False,
) -> None:
    """Show the agent, its devices and their traces in the browser, until Ctrl-C.

    The address opens once, and only on this computer. If the page runs already, another window is
    opened.
    """
    folder = state_folder()
    if end:
        if not ask_to_end(folder):
            raise TransportError(TransportReason.ABSENT, "the page is not running")
        typer.echo("the page has ended")
        _say_what_goes_on(folder)
        return
    path = (settings or settings_path()).absolute()

    def show(way: WayIn) -> None:
        is_open = browser and open_page(way, in_window=window)
        if window and not is_open:
            # The windowed program has no console on which the address could be read.
            message = "no browser could be opened; install Edge or Chrome, or set a default browser"
            raise TransportError(TransportReason.ABSENT, message)
        where = "is open in the browser" if is_open else f"can be opened once, at: {way.address}"
        typer.echo(f"The page {where}")

    if lsl:
        if share:
            message = "--lsl shows streams on this computer alone; leave --share out"
            raise ConfigError(ConfigReason.WRONG_VALUE, message)
        serve_network(path, show)
        return
    while not _shown_by_another(folder, path, show, wants_share=share):
        try:
            _serve(folder, path, show, 60 * end_after, share_port if share else None)
        except ConfigError as error:
            # Another page was started at the same time; ask that one.
            if error.reason is not ConfigReason.IN_USE:
                raise
        else:
            return


def _shown_by_another(
    folder: Path, settings: Path, show: Callable[[WayIn], None], *, wants_share: bool
) -> bool:
    """Ask a page that runs already for another window; return whether there is one."""
    running = ask_for_window(folder)
    if running is None:
        return False
    if Path(running[SETTINGS]) != settings:
        message = (
            f"the page is already running, with the settings file {running[SETTINGS]}; end it "
            "first: biosensor-gateway page --end"
        )
        raise TransportError(TransportReason.BUSY, message)
    if wants_share and not running[IS_SHARED]:
        message = (
            "the page is already running, and other computers cannot view it; end it first: "
            "biosensor-gateway page --end"
        )
        raise TransportError(TransportReason.BUSY, message)
    show(way_into(running))
    return True


def _serve(
    folder: Path,
    settings: Path,
    show: Callable[[WayIn], None],
    end_after_s: float,
    share_port: int | None,
) -> None:
    from biosensor_gateway.page.pages import AgentPage

    def ready(way: WayIn) -> None:
        show(way)
        if server.share is not None:
            typer.echo("Other computers can view it, without changing anything, at:")
            for each in server.share.addresses:
                typer.echo(f"  {each}")
            typer.echo("Their browser asks about the certificate, whose SHA-256 starts with")
            typer.echo(f"  {server.share.fingerprint[:47]}")
        typer.echo("Press Ctrl-C to end the page; the agent continues.")

    # The page starts short-lived threads as long as it is open, and malloc would keep an arena
    # for each.
    limit_arenas(os.environ)
    with DeferredLog(page_folder(folder)) as log, _is_servable():
        server = AgentPage(folder, settings, ready, log.open, end_after_s, share_port)
        server.run()
    _say_what_goes_on(folder)


def _say_what_goes_on(folder: Path) -> None:
    if sentence := said_to_go_on(folder):
        typer.echo(sentence)


@contextlib.contextmanager
def _is_servable() -> Generator[None]:
    try:
        yield
    except OSError as error:
        message = f"the page cannot be served: {error.strerror or error}"
        raise TransportError(TransportReason.BUSY, message) from error


class DeferredLog:
    """Context manager that opens a `StartLog` on request, or when something fails."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._is_open = False
        self._stack = contextlib.ExitStack()

    def open(self) -> None:
        """Begin to log to the file and to the console."""
        from biosensor_gateway.cli.agent_process import StartLog  # takes half a second
        from biosensor_gateway.settings.models import LogSettings

        self._is_open = True
        log = self._stack.enter_context(StartLog(self._folder))
        log.go_on(LogSettings(), verbose=False, title=str)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if isinstance(error, Exception) and not self._is_open:
            self.open()
        self._stack.__exit__(kind, error, trace)


def serve_network(settings: Path, show: Callable[[WayIn], None]) -> None:
    """Show the LSL streams that arrive here, until Ctrl-C.

    Raises
    ------
    ConfigError
        If the settings are wrong.
    TransportError
        If the page cannot be served.
    """
    from biosensor_gateway.page.pages import NetworkPage

    def ready(way: WayIn) -> None:
        show(way)
        typer.echo("Press Ctrl-C to end the page; no stream is touched.")

    # Each inlet has threads, and inlets are opened for the streams that are shown.
    limit_arenas(os.environ)
    with _is_servable():
        NetworkPage(settings, ready).run()
