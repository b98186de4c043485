"""``biosensor-gateway replay``: a recording as LSL streams again."""

from __future__ import annotations

import asyncio
from typing import Annotated

import typer

from biosensor_gateway.cli.loading import settings_or_defaults
from biosensor_gateway.cli.options import (
    FromOption,
    ParticipantOption,
    SettingsOption,
    StreamsOption,
    UntilOption,
    WithoutOption,
)
from biosensor_gateway.cli.recordings import RecordingArgument
from biosensor_gateway.recording.replay.speeds import FASTEST, SLOWEST


def replay(
    file: RecordingArgument,
    speed: Annotated[
        float,
        typer.Option(min=SLOWEST, max=FASTEST, help="Seconds of the recording in one second."),
    ] = 1.0,
    begin: FromOption = "",
    end: UntilOption = "",
    streams: StreamsOption = None,
    participant: ParticipantOption = "",
    without: WithoutOption = "",
    loop: Annotated[
        bool, typer.Option("--loop", help="Begin again at the end, until Ctrl-C.")
    ] = False,
    waits: Annotated[
        bool,
        typer.Option("--wait-for-consumers", help="Begin when every stream has a receiver."),
    ] = False,
    as_original: Annotated[
        bool,
        typer.Option("--as-original", help="Keep the recorded source_ids, for who looks for them."),
    ] = False,
    beside_live: Annotated[
        bool,
        typer.Option("--beside-live", help="Play although a real stream of them is here, too."),
    ] = False,
    settings: SettingsOption = None,
) -> None:
    """Play a recording as LSL streams, with the headers, gaps and times that were recorded.

    Each sample has a stamp of its own, in the recorded distance to all
    others. Headers say that it is a replay, and source_ids begin with
    "replay:", so that nobody takes it for the real sensor; while that is on
    the network nothing is played.
    """
    if as_original and beside_live:
        raise typer.BadParameter("--as-original and --beside-live exclude each other")
    from biosensor_gateway.cli.playing import play  # imports take a second
    from biosensor_gateway.recording.contents.choice import Wish
    from biosensor_gateway.recording.replay.player import Order
    from biosensor_gateway.recording.replay.playing import Wanted
    from biosensor_gateway.system.shutdown import until_signalled

    wanted = Wanted(
        file=file,
        wish=Wish(streams or (), begin, end, participant, without),
        order=Order(speed=speed, loop=loop, waits=waits, as_original=as_original),
        may_be_beside=beside_live,
    )
    lsl = settings_or_defaults(settings).lsl
    asyncio.run(until_signalled(lambda: play(wanted, lsl)))
