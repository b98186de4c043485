"""``biosensor-gateway config``: the settings file, and LSL's.

LabRecorder contains liblsl 1.17. On a computer without an active network adapter, that
version finds only one of several local streams unless ``KnownPeers`` names the computer
itself. It asks known peers on only ``PortRange`` ports; the default of 32 is enough for
16 streams. Both sides must have the same ``SessionID``.

An existing file is edited line by line, so that its other settings and its comments stay
as they are.
"""

from __future__ import annotations

import difflib
import os
import shlex
import subprocess
import sys
from collections.abc import Sequence
from enum import Enum, unique
from itertools import takewhile
from pathlib import Path
from typing import Annotated

import typer
from pydantic import ValidationError

from biosensor_common.child import full_path
from biosensor_common.errors import ConfigError, ConfigReason
from biosensor_common.lsl.api_file import (
    LOOPBACK,
    PEERS,
    PORT_RANGE,
    SESSION,
    Line,
    LslApiFile,
    Ports,
    check_session,
    config_places,
    home_config_file,
    home_folder,
    user_config_file,
)
from biosensor_gateway.cli.options import SettingsOption, settings_or_defaults
from biosensor_gateway.devices.registry import settings_models
from biosensor_gateway.recording.recorder.state import file_going_on
from biosensor_gateway.settings import editor as settings_editor
from biosensor_gateway.settings import file as settings_file
from biosensor_gateway.settings.models import LslSettings
from biosensor_gateway.settings.places import settings_path, state_folder

__all__ = ["LOOPBACK", "LslFile", "Ports", "changes"]
_NEW_FILE = """\
; Settings of the Lab Streaming Layer for LabRecorder and the other LSL programs of this
; computer, written by `biosensor-gateway config lsl`.
"""
_WHY_SESSION = ("; The session of the agent: LSL programs see no streams of other sessions.",)
_WHY_PORTS = (
    "; Covers the ports of the agent's streams, two each. LSL's default of 32 is enough for 16",
    "; streams, and known peers are not asked for more.",
)
_WHY_LOOPBACK = (
    "; LabRecorder and the agent are on this computer. Without a network adapter that is up,",
    "; LabRecorder (liblsl 1.17) sees one stream of many, unless it asks this computer directly.",
)
_WHY_PEERS = ("; The computers to ask directly, because multicast may not get through to them.",)
_OWN_COMMENTS = frozenset((*_WHY_SESSION, *_WHY_PORTS, *_WHY_LOOPBACK, *_WHY_PEERS))


class LslFile(LslApiFile):
    """The text of an LSL configuration file, for editing.

    Parameters
    ----------
    text
        The whole file; empty for a new one.

    Raises
    ------
    ConfigError
        ``MALFORMED`` if liblsl could not parse the file and would ignore it.
    """

    def __init__(self, text: str, source: str) -> None:
        super().__init__(text or _NEW_FILE, source)
        self._newline = "\r\n" if "\r\n" in text else "\n"

    @property
    def text(self) -> str:
        """The edited text."""
        return "".join(line.text for line in self._lines)

    def adapt(self, session_id: str, known_peers: Sequence[str], port_range: int) -> None:
        """Set what LabRecorder needs; other peers and a larger port range are kept."""
        if self._get(SESSION) != session_id:
            self._set(SESSION, session_id, _WHY_SESSION)
        peers = tuple(dict.fromkeys((*self.known_peers, *known_peers)))
        if peers != self.known_peers or not self._get(PEERS).startswith("{"):
            self._set(PEERS, "{" + ", ".join(peers) + "}", _why_peers(peers))
        if self._number(PORT_RANGE, 0) < port_range:
            self._set(PORT_RANGE, str(port_range), _WHY_PORTS)

    def _set(self, name: tuple[str, str], value: str, why: Sequence[str]) -> None:
        section, key = name
        block = [
            *(Line(comment + self._newline, section) for comment in why),
            Line(f"{key} = {value}{self._newline}", section, key, value),
        ]
        start, end = self._place(name)
        self._lines[start:end] = block

    def _place(self, name: tuple[str, str]) -> tuple[int, int]:
        """Return the range of lines to replace: the setting with our comments, or an empty one."""
        section, _ = name
        for at, line in enumerate(self._lines):
            if (line.section, line.key) == name:
                start = at
                while start and self._lines[start - 1].text.strip() in _OWN_COMMENTS:
                    start -= 1
                return start, at + 1
        self._end_last_line()
        in_section = [at for at, line in enumerate(self._lines) if line.section == section]
        if in_section:
            filled = [at for at in in_section if self._lines[at].text.strip()]
            return filled[-1] + 1, filled[-1] + 1
        heading = f"[{section}]{self._newline}"
        self._lines += [Line(self._newline, ""), Line(heading, section)]
        return len(self._lines), len(self._lines)

    def _end_last_line(self) -> None:
        if self._lines and not self._lines[-1].text.endswith("\n"):
            self._lines[-1].text += self._newline


def _why_peers(peers: Sequence[str]) -> tuple[str, ...]:
    local = _WHY_LOOPBACK if LOOPBACK in peers else ()
    others = _WHY_PEERS if any(peer != LOOPBACK for peer in peers) else ()
    return (*local, *others)


def changes(before: str, after: str) -> list[str]:
    """Return the lines that differ: removed ones begin with ``- ``, added ones with ``+ ``."""
    compared = difflib.ndiff(before.splitlines(), after.splitlines())
    return [
        # Bytes that are not UTF-8 are kept in the file, but a console cannot show them.
        line.rstrip().encode("utf-8", "replace").decode()
        for line in compared
        if line[0] in "+-" and line[2:].strip()
    ]


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
        bool, typer.Option("--force", help="Change an existing file; a copy of it is kept.")
    ] = False,
    settings: SettingsOption = None,
) -> None:
    """Write an lsl_api.cfg with which LabRecorder on this computer finds every stream."""
    peers = tuple(peer or ())
    if arrangement is Arrangement.TWO_PC and not peers:
        raise typer.BadParameter("two-pc needs the other computer: add --peer ADDRESS")
    path = (out or home_config_file(home_folder())).expanduser()
    lsl = settings_or_defaults(settings).lsl
    local = (LOOPBACK,) if arrangement is Arrangement.SINGLE_PC else ()
    session_id = lsl.session_id or _session_of_own_file()
    before = _read(path)
    file = LslFile(before or "", str(path))
    file.adapt(session_id, tuple(dict.fromkeys((*local, *peers))), lsl.port_range)
    _store(path, before, file.text, force=force)
    _report(path, file, others=peers)


def _session_of_own_file() -> str:
    """Return the session of the LSL file that the agent uses when its settings name none."""
    own = user_config_file(os.environ, home_folder(), Path.cwd())
    session_id = LslFile((own and _read(own)) or "", str(own)).session_id
    check_session(session_id, own)
    return session_id


def _read(path: Path) -> str | None:
    try:
        # Bytes that are not UTF-8 pass through unchanged.
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
    """Print what is left to do; *others* are the other computers with agents."""
    typer.echo(f"LSL session: {file.session_id}; asked directly: {', '.join(file.known_peers)}")
    typer.echo("Restart LabRecorder: LSL programs read the file when they start.")
    if others:
        ports = file.ports
        typer.echo(
            f"The firewalls of this computer and of {', '.join(others)} must allow incoming UDP "
            f"{ports.discovery}, and UDP and TCP {ports.first} to {ports.last}."
        )
        typer.echo("The agents there must use the same LSL session.")
    for warning in _warnings(path):
        typer.echo(f"warning: {warning}", err=True)


def _warnings(path: Path) -> list[str]:
    """Return what keeps LSL programs from reading the file."""
    places = config_places(os.environ, home_folder(), Path.cwd())
    before = list(takewhile(lambda place: place.resolve() != path.resolve(), places))
    if len(before) == len(places):
        return [f"LSL does not look there; set the environment variable LSLAPICFG to {path}"]
    named = os.environ.get("LSLAPICFG")
    because = "because the environment variable LSLAPICFG names it"
    where = "in programs started in its folder"
    return [
        f"{other} takes precedence over it, {because if other == Path(named or '') else where}"
        for other in before
        if other.is_file()
    ]


if sys.platform == "win32":
    from biosensor_common.child import windows_folder


def open_in_editor(path: Path) -> None:
    """Open a file in the editor that the user has chosen for text.

    Windows: the program for the file's ending, else Notepad; neither is waited for.
    macOS: the text editor. Elsewhere ``$VISUAL`` or ``$EDITOR``, which may need the
    terminal and is waited for, else ``xdg-open``.

    Raises
    ------
    ConfigError
        ``NOT_FOUND`` if there is no editor, ``UNREADABLE`` if it failed.
    """
    if sys.platform == "win32":
        _open_on_windows(path)
    elif sys.platform == "darwin":
        _run(["open", "-t"], path)
    elif editor := os.environ.get("VISUAL") or os.environ.get("EDITOR"):
        _run(_words(editor, path), path)
    elif full_path("xdg-open"):
        _run(["xdg-open"], path)
    else:
        message = f"no editor was found; set EDITOR to the one you use, or open {path} by hand"
        raise ConfigError(ConfigReason.NOT_FOUND, message)


if sys.platform == "win32":

    def _open_on_windows(path: Path) -> None:
        try:
            os.startfile(path)  # noqa: S606 - that is its purpose
        except OSError:
            # No program is known for the file's ending.
            notepad = str(windows_folder(system=False) / "notepad.exe")
            try:
                subprocess.Popen([notepad, path])
            except OSError as error:
                raise _failed(notepad, path, error.strerror or str(error)) from error


def _words(editor: str, path: Path) -> list[str]:
    try:
        return shlex.split(editor)
    except ValueError as error:
        raise _failed(editor, path, str(error)) from error


def _run(command: Sequence[str], path: Path) -> None:
    name, *options = command or [""]
    program = name if "/" in name else full_path(name)
    if program is None:
        raise _failed(name, path, "it is not in any folder of PATH")
    try:
        code = subprocess.run([program, *options, path], check=False).returncode
    except OSError as error:
        raise _failed(name, path, error.strerror or str(error)) from error
    if code:
        raise _failed(name, path, f"exit code {code}")


def _failed(editor: str, path: Path, why: str) -> ConfigError:
    message = f"the editor {editor} could not open {path}: {why}; open the file by hand"
    return ConfigError(ConfigReason.UNREADABLE, message)


app = typer.Typer(no_args_is_help=True)


@app.callback()
def _group() -> None:
    """The settings file."""  # noqa: D401 - as the list has it


app.command("lsl")(write_lsl_file)


@app.command("path")
def print_path() -> None:
    """Print where the settings file is."""
    typer.echo(settings_path())


@app.command("init")
def write_template(settings: SettingsOption = None) -> None:
    """Write a settings file with every setting explained; never overwrite one."""
    path = settings or settings_path()
    settings_editor.write_template(path, settings_models())
    typer.echo(f"wrote {path}; add your devices there")


@app.command("edit")
def edit(settings: SettingsOption = None) -> None:
    """Open the settings file in your editor; write it first if there is none."""
    recorded = file_going_on(state_folder())
    if recorded is not None:
        warning = (
            f"a recording is running, to {recorded}: do not reload until it has ended, or it may "
            "lose the devices that you change"
        )
        typer.echo(f"! {warning}", err=True)
    path = (settings or settings_path()).absolute()
    if not path.exists():
        settings_editor.write_template(path, settings_models())
        typer.echo(f"wrote {path}")
    open_in_editor(path)


@app.command("check")
def check(settings: SettingsOption = None) -> None:
    """Check the settings file; show every problem with its line; exit code 2 if it is wrong."""
    path = settings or settings_path()
    loaded = settings_file.load_settings(path, settings_models())
    typer.echo(f"{path}: {len(loaded.devices)} devices, no problem found")
