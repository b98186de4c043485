"""``biosensor-gateway config lsl``: a configuration with which LabRecorder finds every stream."""

from __future__ import annotations

import os
from enum import Enum, unique
from itertools import takewhile
from pathlib import Path
from typing import Annotated

import typer
from pydantic import ValidationError

from biosensor_common.errors import ConfigError, ConfigReason
from biosensor_common.lsl_config import config_places, home_config_file, user_config_file
from biosensor_gateway.cli.loading import settings_or_defaults
from biosensor_gateway.cli.options import SettingsOption
from biosensor_gateway.recording.lsl_api_cfg import LOOPBACK, LslFile, changes
from biosensor_gateway.settings.models import LslSettings


@unique
class Arrangement(Enum):
    """Where LabRecorder and the agents are."""

    SINGLE_PC = "single-pc"
    TWO_PC = "two-pc"


def _checked_peers(peers: list[str] | None) -> list[str]:
    try:
        return list(LslSettings(known_peers=tuple(dict.fromkeys(peers or ()))).known_peers)
    except ValidationError:
        raise typer.BadParameter("should be a host name or an IP address") from None


PeersOption = Annotated[
    list[str] | None,
    typer.Option(
        "--peer",
        help="Host name or IP address of a computer with an agent (repeatable).",
        callback=_checked_peers,
    ),
]


def write_lsl_file(
    arrangement: Annotated[
        Arrangement,
        typer.Option(
            "--for",
            help="single-pc: LabRecorder and agent are on this computer; "
            "two-pc: LabRecorder is on this computer, the agents are on others.",
        ),
    ] = Arrangement.SINGLE_PC,
    peer: PeersOption = None,
    out: Annotated[
        Path | None, typer.Option(help="File to write instead of ~/lsl_api/lsl_api.cfg.")
    ] = None,
    force: Annotated[
        bool, typer.Option("--force", help="Change a file that exists; a copy of it is kept.")
    ] = False,
    settings: SettingsOption = None,
) -> None:
    """Write an lsl_api.cfg with which LabRecorder on this computer finds every stream."""
    peers = tuple(peer or ())
    if arrangement is Arrangement.TWO_PC and not peers:
        raise typer.BadParameter("two-pc needs the other computer: add --peer ADDRESS")
    path = (out or home_config_file(Path.home())).expanduser()
    lsl = settings_or_defaults(settings).lsl
    local = (LOOPBACK,) if arrangement is Arrangement.SINGLE_PC else ()
    session_id = lsl.session_id or _session_of_own_file()
    before = _read(path)
    file = LslFile(before or "", str(path))
    file.adapt(session_id, tuple(dict.fromkeys((*local, *peers))), lsl.port_range)
    _store(path, before, file.text, force=force)
    _report(path, file, others=peers)


def _session_of_own_file() -> str:
    """Return the session that the agent takes over, as its settings name none."""
    own = user_config_file(os.environ, Path.home(), Path.cwd())
    return LslFile((own and _read(own)) or "", str(own)).session_id


def _read(path: Path) -> str | None:
    try:
        # Bytes that are no UTF-8 pass through unchanged.
        return path.read_bytes().decode("utf-8", "surrogateescape")
    except FileNotFoundError:
        return None
    except OSError as error:
        raise _inaccessible(path, "read", error) from error


def _store(path: Path, before: str | None, after: str, *, force: bool) -> None:
    if before == after:
        typer.echo(f"{path} holds all that LabRecorder needs; nothing was changed")
        return
    if before is not None:
        for line in changes(before, after):
            typer.echo(f"  {line}")
        if not force:
            message = (
                f"{path} exists and was not changed; add --force to change these lines "
                "(a copy of the file is kept)"
            )
            raise ConfigError(ConfigReason.EXISTS, message)
        typer.echo(f"kept the file as it was in {_back_up(path)}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("xb" if before is None else "wb") as file:
            file.write(after.encode("utf-8", "surrogateescape"))
    except OSError as error:
        raise _inaccessible(path, "write", error) from error
    typer.echo(f"wrote {path}")


def _back_up(path: Path) -> Path:
    """Copy a file to the first free name beside it."""
    copy, number = path.with_name(f"{path.name}.bak"), 1
    try:
        while copy.exists():
            number += 1
            copy = path.with_name(f"{path.name}.bak{number}")
        with copy.open("xb") as file:
            file.write(path.read_bytes())
    except OSError as error:
        raise _inaccessible(copy, "write", error) from error
    return copy


def _inaccessible(path: Path, verb: str, error: OSError) -> ConfigError:
    message = f"cannot {verb} {path}: {error.strerror or error}"
    return ConfigError(ConfigReason.UNREADABLE, message)


def _report(path: Path, file: LslFile, others: tuple[str, ...]) -> None:
    """Say what is left to do; *others* are the computers across the network."""
    typer.echo(f"LSL session: {file.session_id}; asked directly: {', '.join(file.known_peers)}")
    typer.echo("Restart LabRecorder: LSL programs read the file when they start.")
    if others:
        ports = file.ports
        typer.echo(
            f"The firewalls of this computer and of {', '.join(others)} must let in "
            f"UDP {ports.discovery}, and UDP and TCP {ports.first} to {ports.last}."
        )
        typer.echo("The agents there must have the same LSL session.")
    for warning in _warnings(path):
        typer.echo(f"warning: {warning}", err=True)


def _warnings(path: Path) -> list[str]:
    """Say what keeps LSL programs from reading the file."""
    places = config_places(os.environ, Path.home(), Path.cwd())
    before = list(takewhile(lambda place: place.resolve() != path.resolve(), places))
    if len(before) == len(places):
        return [f"LSL does not look there; set the environment variable LSLAPICFG to {path}"]
    named = os.environ.get("LSLAPICFG")
    because = "because the environment variable LSLAPICFG names it"
    where = "in programs that are started in its folder"
    return [
        f"{other} goes before it, {because if other == Path(named or '') else where}"
        for other in before
        if other.is_file()
    ]
