"""``biosensor-gateway mark``: a marker for the recording, by hand or from a script."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from biosensor_common.terminal import columns, wrapped
from biosensor_gateway.agent import control
from biosensor_gateway.cli import BEGUN_S
from biosensor_gateway.settings.places import state_folder

_SOURCE = "command"
_KEYS = 9
"""As many buttons have a key: 1 to 9."""


def mark(
    text: Annotated[
        str, typer.Argument(metavar="TEXT", help="What happened; with --undo, the marker's id.")
    ] = "",
    note: Annotated[bool, typer.Option("--note", help="Write TEXT down as a note.")] = False,
    undo: Annotated[
        bool, typer.Option("--undo", help="Undo a marker; without its id, the last one.")
    ] = False,
    listed: Annotated[
        bool, typer.Option("--list", help="Show the last markers, and the buttons.")
    ] = False,
    web: Annotated[
        bool, typer.Option("--web", help="Show what a web experiment needs: address and token.")
    ] = False,
    new_token: Annotated[
        bool, typer.Option("--new-token", help="With --web: make another token.")
    ] = False,
    save: Annotated[
        Path | None,
        typer.Option(metavar="FOLDER", help="With --web: write its script and an example there."),
    ] = None,
) -> None:
    """Send a marker with the streams: what happens now. One can be undone, not deleted.

    Exit code 1 if no agent runs or it refuses.
    """
    if undo + listed + note + web > 1:
        raise typer.BadParameter("--note, --undo, --list and --web exclude each other")
    if (new_token or save) and not web:
        raise typer.BadParameter("--new-token and --save go with --web")
    if bool(text.strip()) == (listed or web) and not undo:
        raise typer.BadParameter("--list and --web need no TEXT" if text else "there is no TEXT")
    if web:
        _show_web(save, renew=new_token)
        return
    folder = state_folder()
    if listed:
        _print_list(control.ask(folder, "markers"))
    elif undo:
        done = control.ask(folder, "undo-marker", {"id": _number(text)} if text else {})
        typer.echo(f"marker {done['of']} is undone")
    else:
        said = {"note": text, "kind": "note"} if note else {"marker": text, "kind": "api"}
        sent = control.ask(folder, "mark", {**said, "source": _SOURCE, "at": _when_given()})
        lost = "" if sent.get("received", True) else ", but no program receives it"
        typer.echo(f"marker {sent['id']} was sent{lost}")


def _show_web(save: Path | None, *, renew: bool) -> None:
    from biosensor_gateway.cli import web_marking  # a marker does without

    if save is not None:
        web_marking.save(save)
    web_marking.show(renew=renew)


def _when_given() -> float:
    """Return the LSL time at which the command was given."""
    from pylsl import local_clock  # an undo does without

    return local_clock() - (time.perf_counter() - BEGUN_S)


def _number(text: str) -> int:
    try:
        return int(text)
    except ValueError:
        raise typer.BadParameter(f"{text!r} is not the id of a marker; see --list") from None


def _print_list(answer: Mapping[str, Any]) -> None:
    from pylsl import local_clock  # an undo does without

    width, now = columns(sys.stdout), local_clock()
    rows = [_row(each, now) for each in answer["markers"]] or [("", "nothing is marked yet")]
    rows += _buttons(answer["buttons"])
    for lead, said in rows:
        typer.echo(wrapped(f"{lead}{said}", width, hang=len(lead)))


def _row(marker: Mapping[str, Any], now: float) -> tuple[str, str]:
    said = f"{marker['marker']}: {marker['note']}" if marker["note"] else marker["marker"]
    undone = " (undone)" if marker["undone"] else ""
    origin = f", from {marker['source']}" if marker["kind"] == "web" else ""
    origin += "" if marker.get("received", True) else ", received by nobody"
    return f"{marker['id']:>5}  {now - marker['lsl_time']:8.1f} s ago  ", f"{said}{origin}{undone}"


def _buttons(names: list[str]) -> Iterator[tuple[str, str]]:
    if names:
        keys = (f"{at} " if at <= _KEYS else "" for at in range(1, len(names) + 1))
        yield "buttons: ", ", ".join(f"{key}{name}" for key, name in zip(keys, names, strict=True))
