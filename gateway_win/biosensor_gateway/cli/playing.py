"""Plays a recording and says how it goes."""

from __future__ import annotations

import asyncio
import sys
import threading
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console
from rich.live import Live
from rich.text import Text

from biosensor_common.lsl_config import LslOverrides
from biosensor_gateway.cli import playing_words as words
from biosensor_gateway.cli.recordings import wrong_recording
from biosensor_gateway.cli.screen import say
from biosensor_gateway.recording.contents.choice import Wish, choose
from biosensor_gateway.recording.replay.live import refuse_if_present
from biosensor_gateway.recording.replay.player import Order, Player
from biosensor_gateway.recording.replay.source import content_hash, opened
from biosensor_gateway.settings.models import LslSettings
from biosensor_gateway.streaming.outlets import configure_lsl

_SHOWN_PER_S = 2


@dataclass(frozen=True, slots=True)
class Wanted:
    """What to play, and how; `may_be_beside`: although the real streams are here, too."""

    file: Path
    wish: Wish
    order: Order
    may_be_beside: bool


async def play(wanted: Wanted, lsl: LslSettings) -> None:
    """Play to the end, or until cancelled.

    Raises
    ------
    ConfigError
        If the file cannot be read, or what is wanted is not in it.
    ReplayError
        If it is not played, see its reasons.
    """
    configure_lsl(LslOverrides(lsl.session_id, lsl.known_peers, lsl.port_range))
    stopping = threading.Event()
    work = asyncio.get_running_loop().run_in_executor(None, _play, wanted, stopping)
    try:
        await asyncio.shield(work)
    except asyncio.CancelledError:
        stopping.set()
        await work
        raise


def _play(wanted: Wanted, stopping: threading.Event) -> None:
    with wrong_recording(), opened(wanted.file) as contents:
        for sentence in words.damaged(contents.damages):
            say(sentence)
        player = Player(choose(contents, wanted.wish), wanted.order, content_hash(contents.path))
        refuse_if_present(
            player.own_ids,
            player.recorded_ids,
            wanted.file.name,
            may_be_beside=wanted.may_be_beside,
        )
        if not stopping.is_set():
            player.offer()
            say(words.begun(wanted.file.name, player, wanted.order.speed))
            with _shown(player):
                player.run(stopping)
        for sentence in words.ended(player, was_stopped=stopping.is_set()):
            say(sentence)


@contextmanager
def _shown(player: Player) -> Generator[None]:
    """Show how it goes, in a line that goes away at the end; only on a terminal."""
    if not sys.stdout.isatty():
        yield
        return

    def line() -> Text:
        text = words.line(player.progress(), len(player.streams))
        return Text(text, no_wrap=True, overflow="ellipsis")

    # Drawn by a thread of its own, so that a console that is held keeps no sample.
    with Live(
        console=Console(), get_renderable=line, refresh_per_second=_SHOWN_PER_S, transient=True
    ):
        yield
