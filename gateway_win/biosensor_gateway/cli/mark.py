"""``biosensor-gateway mark``: a marker for the recording, by hand or from a script."""

from __future__ import annotations

import shutil
import socket
import sys
import time
from collections.abc import Iterator, Mapping
from importlib.resources import as_file, files
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from biosensor_common.errors import ConfigError, ConfigReason, cannot_write
from biosensor_common.terminal import columns, wrapped
from biosensor_gateway.agent import control
from biosensor_gateway.cli import BEGUN_S
from biosensor_gateway.settings.places import state_folder

if TYPE_CHECKING:
    from biosensor_gateway.settings.models import WebMarkerSettings

_SOURCE = "command"
_KEYS = 9
"""Number of buttons that have a key on the page: 1 to 9."""
_EXAMPLE = 'origins = ["http://localhost:8080"]'
_LEAD = 9
_LISTENS_WITHIN_S = 1.0


def mark(
    text: Annotated[
        str, typer.Argument(metavar="TEXT", help="What happened; with --undo, the marker's id.")
    ] = "",
    note: Annotated[bool, typer.Option("--note", help="Record TEXT as a note.")] = False,
    undo: Annotated[
        bool, typer.Option("--undo", help="Undo a marker; without an id, the last one.")
    ] = False,
    listed: Annotated[
        bool, typer.Option("--list", help="Show the last markers, and the buttons.")
    ] = False,
    web: Annotated[
        bool, typer.Option("--web", help="Show what a web experiment needs: address and token.")
    ] = False,
    new_token: Annotated[
        bool, typer.Option("--new-token", help="With --web: make a new token.")
    ] = False,
    save: Annotated[
        Path | None,
        typer.Option(metavar="FOLDER", help="With --web: write its script and an example there."),
    ] = None,
) -> None:
    """Send a marker of what happens now. A marker can be undone, but not deleted.

    Exit code 1 if no agent runs or it refuses.
    """
    if undo + listed + note + web > 1:
        raise typer.BadParameter("--note, --undo, --list and --web exclude each other")
    if (new_token or save) and not web:
        raise typer.BadParameter("--new-token and --save need --web")
    if bool(text.strip()) == (listed or web) and not undo:
        raise typer.BadParameter("--list and --web need no TEXT" if text else "TEXT is missing")
    if web:
        if save is not None:
            _save_web(save)
        _show_web(renew=new_token)
        return
    folder = state_folder()
    if listed:
        _print_list(control.ask(folder, "markers"))
    elif undo:
        done = control.ask(folder, "undo-marker", {"id": _number(text)} if text else {})
        typer.echo(f"marker {done['of']} is undone")
    else:
        marker = {"note": text, "kind": "note"} if note else {"marker": text, "kind": "api"}
        sent = control.ask(folder, "mark", {**marker, "source": _SOURCE, "at": _when_given()})
        lost = "" if sent.get("received", True) else ", but no program receives it"
        typer.echo(f"marker {sent['id']} was sent{lost}")


def _when_given() -> float:
    """Return the LSL time at which the command was given."""
    from pylsl import local_clock  # slow to import, and not needed by --undo

    return local_clock() - (time.perf_counter() - BEGUN_S)


def _number(text: str) -> int:
    try:
        return int(text)
    except ValueError:
        raise typer.BadParameter(f"{text!r} is not the id of a marker; see --list") from None


def _print_list(answer: Mapping[str, Any]) -> None:
    from pylsl import local_clock  # as above

    width, now = columns(sys.stdout), local_clock()
    rows = [_row(each, now) for each in answer["markers"]] or [("", "there are no markers yet")]
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


def _show_web(*, renew: bool) -> None:
    """Print address, token, origins, and the link that opens each experiment.

    Raises
    ------
    ConfigError
        If the settings are wrong, or the token can neither be read nor written.
    """
    from biosensor_gateway.cli.options import settings_or_defaults
    from biosensor_gateway.page.experiments.experiment_server import (
        experiment_token,
        new_experiment_token,
    )

    folder = state_folder()
    token = new_experiment_token(folder) if renew else experiment_token(folder)
    web = settings_or_defaults(None).markers.web
    for lead, said in _web_rows(web, token):
        # A token or an address must stay on one line to be copied.
        text = f"{lead:{_LEAD}}{said}"
        fits = " " not in said
        typer.echo(text if fits else wrapped(text, columns(sys.stdout), hang=_LEAD))


def _save_web(folder: Path) -> None:
    """Write the script for web experiments and an example into a folder.

    Raises
    ------
    ConfigError
        ``EXISTS`` if a different file is in the way, ``UNREADABLE`` if one cannot be written.
    """
    with as_file(files("biosensor_gateway.page.experiments") / "files") as found:
        for source in sorted(found.iterdir()):
            target = folder / source.name
            try:
                folder.mkdir(parents=True, exist_ok=True)
                if target.exists() and target.read_bytes() != source.read_bytes():
                    message = f"{target} exists and is not overwritten; move it first"
                    raise ConfigError(ConfigReason.EXISTS, message)
                shutil.copyfile(source, target)
            except OSError as error:
                message = cannot_write(target, error)
                raise ConfigError(ConfigReason.UNREADABLE, message) from error
            typer.echo(f"wrote {target}")


def _web_rows(web: WebMarkerSettings, token: str) -> Iterator[tuple[str, str]]:
    from biosensor_gateway.settings.models import OF_NO_SITE, USUAL_PORT

    yield "address", f"ws://127.0.0.1:{web.port}"
    yield "token", token
    if not web.origins:
        yield (
            "origins",
            f"none, so nothing listens; write in the settings, under [markers.web]: {_EXAMPLE}",
        )
        return
    port = "" if web.port == USUAL_PORT else f"&port={web.port}"
    for lead, origin in zip(["origins"] + [""] * len(web.origins), web.origins, strict=False):
        is_site = origin != OF_NO_SITE
        yield lead, f"{origin}/#gateway={token}{port}" if is_site else "null (a page from a file)"
    if not _listens(web.port):
        yield "", "nothing listens there yet; open the page: biosensor-gateway page"


def _listens(port: int) -> bool:
    try:
        socket.create_connection(("127.0.0.1", port), _LISTENS_WITHIN_S).close()
    except OSError:
        return False
    return True
