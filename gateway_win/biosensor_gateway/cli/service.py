"""``biosensor-gateway service``: the agent as a systemd service of this user, on Linux."""

from __future__ import annotations

import contextlib
import os
import subprocess
from collections.abc import Mapping, Sequence
from pathlib import Path

import typer

from biosensor_common.child import full_path
from biosensor_common.errors import TransportError, TransportReason, cannot_write
from biosensor_common.lsl.api_file import home_folder
from biosensor_gateway.cli import KEEP_ALIVE
from biosensor_gateway.cli.options import SettingsOption
from biosensor_gateway.system import state_file
from biosensor_gateway.system.child import own_command

UNIT = "biosensor-gateway.service"

_TIME_LIMIT_S = 20.0


def unit_text(arguments: Sequence[str]) -> str:
    """Return the unit that runs this program with arguments; see ``systemd.service(5)``."""
    command = " ".join(_quoted(each) for each in own_command(arguments))
    return f"""\
# Written by: biosensor-gateway service install
[Unit]
Description=Biosensor Gateway capture agent
StartLimitIntervalSec=0

[Service]
ExecStart={command}
# The program starts a dead agent again by itself; this is for the case that both were killed.
Restart=on-failure
RestartSec=5
# Wrong settings are wrong the next time, too.
RestartPreventExitStatus=2
TimeoutStopSec=20

[Install]
WantedBy=default.target
"""


def unit_path(environment: Mapping[str, str], home: Path) -> Path:
    """Return the path of this user's unit, by the XDG base directory specification."""
    folder = environment.get("XDG_CONFIG_HOME", "")
    base = Path(folder) if folder.startswith("/") else home / ".config"
    return base / "systemd" / "user" / UNIT


def install(arguments: Sequence[str]) -> Path:
    """Write the unit, start it now and at each login; return its path.

    Raises
    ------
    TransportError
        ``ABSENT`` if there is no systemd, ``DENIED`` if the unit cannot be written,
        ``UNAVAILABLE`` if systemd does not start it.
    """
    systemctl = _systemctl()
    path = unit_path(os.environ, home_folder())
    try:
        state_file.replace(path, unit_text(arguments))
    except OSError as error:
        message = cannot_write(path, error)
        raise TransportError(TransportReason.DENIED, message) from error
    for command in (["daemon-reload"], ["enable", UNIT], ["restart", UNIT]):
        problem = _problem(systemctl, *command)
        if problem is not None:
            message = (
                f"{path} is written, but systemd does not start it ({problem}); log in to a "
                f"session of this computer, and then: systemctl --user enable --now {UNIT}"
            )
            raise TransportError(TransportReason.UNAVAILABLE, message)
    return path


def remove() -> bool:
    """Stop the service and remove its unit; return whether there was one.

    Raises
    ------
    TransportError
        As for :func:`install`.
    """
    systemctl = _systemctl()
    path = unit_path(os.environ, home_folder())
    if not path.exists():
        return False
    problem = _problem(systemctl, "disable", "--now", UNIT)
    with contextlib.suppress(FileNotFoundError):
        path.unlink()
    if problem is not None:
        message = (
            f"{path} is removed, but systemd may still be running the agent ({problem}); end it "
            "with: biosensor-gateway stop"
        )
        raise TransportError(TransportReason.UNAVAILABLE, message)
    return True


def _systemctl() -> str:
    path = full_path("systemctl")
    if path is None:
        message = (
            "there is no systemd here, which is needed for services on Linux; on Windows choose "
            "'start with Windows' in the installer"
        )
        raise TransportError(TransportReason.ABSENT, message)
    return path


def _problem(systemctl: str, *arguments: str) -> str | None:
    """Call systemctl; return its error, or None if it succeeds."""
    try:
        done = subprocess.run(
            [systemctl, "--user", *arguments],
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            errors="replace",
            timeout=_TIME_LIMIT_S,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return f"it does not answer within {_TIME_LIMIT_S:g} s"
    except OSError as error:
        return error.strerror or str(error)
    if done.returncode == 0:
        return None
    lines = done.stderr.strip().splitlines()
    return lines[-1] if lines else f"exit code {done.returncode}"


def _quoted(word: str) -> str:
    """Quote a word for a unit: escape quotes, variables and specifiers."""
    for special, escaped in (("\\", "\\\\"), ('"', '\\"'), ("$", "$$"), ("%", "%%")):
        word = word.replace(special, escaped)
    return f'"{word}"'


app = typer.Typer(no_args_is_help=True)


@app.callback()
def _group() -> None:
    """The agent as a service of this user (Linux)."""  # noqa: D401 - as the list has it


@app.command("install")
def install_service(settings: SettingsOption = None) -> None:
    """Run the agent now and whenever you are logged in, and restart it whenever it dies."""
    chosen = () if settings is None else ("--settings", str(settings.resolve()))
    path = install(("run", KEEP_ALIVE, *chosen))
    typer.echo(
        f"the agent runs as a service ({path})\n"
        "look at it:      biosensor-gateway status\n"
        "end it for now:  biosensor-gateway stop\n"
        "to have it run from the computer's start on, without a login: loginctl enable-linger"
    )


@app.command("remove")
def remove_service() -> None:
    """End the service, and remove it."""
    typer.echo("the service is removed" if remove() else "there is no service")
