"""``biosensor-gateway bag``: bags of ROS."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from biosensor_gateway.cli.options import JsonOption, wrong_recording
from biosensor_gateway.cli.output import say
from biosensor_gateway.recording.xdf.report_text import printable
from biosensor_gateway.system.shutdown import requests_interrupt

_MOST_SENTENCES = 10

app = typer.Typer(no_args_is_help=True)


@app.callback()
def _group(context: typer.Context) -> None:
    """Bags of ROS (MCAP or SQLite); no ROS is needed."""
    context.with_resource(requests_interrupt())


@app.command("import")
def import_recording(
    bag: Annotated[
        Path, typer.Argument(help="A folder of ros2 bag record, or a file.", show_default=False)
    ],
    output: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.xdf",
            help="File to write, instead of NAME.xdf next to the bag.",
            show_default=False,
        ),
    ] = None,
    print_json: JsonOption = False,
) -> None:
    """Write a bag as a recording (XDF); exit code 1 if some of it cannot be read.

    A bag that was made from a recording becomes that recording again. In any
    other bag, stamped topics of the node become its streams, and the numbers
    of all other messages become channels named after their fields. No file
    is overwritten.
    """
    from biosensor_gateway.recording.bag.conversion import import_bag, usual_path  # rosbags

    with wrong_recording():
        imported = import_bag(bag, output or usual_path(bag))
    if print_json:
        content = {
            "bag": str(imported.path),
            "written": str(imported.written),
            "streams": [{"topic": name, "samples": count} for name, count in imported.streams],
            "left_out": imported.left_out,
            "damages": imported.damages,
            "guess": imported.guess,
        }
        typer.echo(json.dumps(content, indent=2))
    else:
        _say(
            [f"{topic} is left out: {why}" for topic, why in imported.left_out.items()],
            list(imported.damages),
            [imported.guess] if imported.guess else [],
        )
        samples = sum(count for _, count in imported.streams)
        say(f"wrote {imported.written}: {len(imported.streams)} streams, {samples} samples")
    if imported.damages:
        raise typer.Exit(1)


def _say(*groups: list[str]) -> None:
    for sentences in groups:
        for sentence in sentences[:_MOST_SENTENCES]:
            say(printable(sentence))
        if (more := len(sentences) - _MOST_SENTENCES) > 0:
            say(f"and {more} more like these")
