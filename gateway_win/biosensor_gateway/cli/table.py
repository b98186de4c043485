"""Lists the commands with the first line of their help.

A new one is a module here and a line below; what the line says of it is the beginning of
its docstring.
"""

from __future__ import annotations

import sys
from functools import partial
from importlib import import_module
from typing import TYPE_CHECKING, Any

import typer
from typer.core import TyperCommand

from biosensor_gateway.cli.quick_help import QuickCommand

if TYPE_CHECKING:
    from typer._click import Command, Context


class Deferred(TyperCommand):
    """Stands for a command, or for a group of commands, in the list of all commands.

    Parameters
    ----------
    name
        As it is typed.
    place
        ``module:attribute`` of the function, or of the Typer of a group.
    first_lines
        The beginning of its help, which the list shows without importing it.
    hidden
        Whether the list leaves it out.
    """

    def __init__(self, name: str, place: str, first_lines: str, *, hidden: bool = False) -> None:
        super().__init__(name, help=first_lines, hidden=hidden)
        self.place = place

    def load(self) -> Command:
        """Import the command."""
        module, _, attribute = self.place.partition(":")
        found = getattr(import_module(module), attribute)
        if isinstance(found, typer.Typer):
            return typer.main.get_group(found)
        alone = typer.Typer(add_completion=False)
        alone.command(self.name, cls=QuickCommand)(found)
        return typer.main.get_command(alone)

    def make_context(
        self,
        info_name: str | None,
        args: list[str],
        parent: Context | None = None,
        **extra: Any,  # noqa: ANN401 - as in typer
    ) -> Context:
        """Import the command, and return its own context, in which it is then invoked."""
        return self.load().make_context(info_name, args, parent, **extra)


def _command(name: str, place: str, first_lines: str, *, hidden: bool = False) -> Deferred:
    return Deferred(name, f"biosensor_gateway.cli.{place}", first_lines, hidden=hidden)


_hidden = partial(_command, hidden=True)
# Elsewhere they can only say why they cannot be.
_on_linux = partial(_command, hidden=sys.platform != "linux")

COMMANDS = (
    _command(
        "run",
        "running:run",
        "Stream all devices of the settings until Ctrl-C, or until it is told to stop.",
    ),
    _command(
        "stop",
        "stopping:stop",
        "End the running agent; exit code 1 if none runs or it does not end in time.",
    ),
    _command(
        "pause",
        "pauses:pause",
        "Send nothing of a device from now on, also after a restart, until it is resumed.",
    ),
    _command(
        "resume",
        "pauses:resume",
        "Send again what a paused device measures from now on.",
    ),
    _command(
        "reload",
        "reloading:reload",
        "Have the running agent read its settings again; devices that are the same stream on.",
    ),
    _command(
        "page",
        "page:page",
        "Show the agent, its devices and their traces in the browser, until Ctrl-C.",
    ),
    _command(
        "mark",
        "marking:mark",
        "Send a marker with the streams: what happens now. One can be undone, not deleted.",
    ),
    _command(
        "try",
        "trying:try_out",
        "Try it without hardware: a page with virtual sensors, a recording, and its tables.",
    ),
    _on_linux("demo", "demo:demo", "Show all virtual devices on their way to ROS topics."),
    _command(
        "status", "status:status", "Show what the running agent does; exit code 1 if none runs."
    ),
    _command(
        "clocks",
        "clocks:clocks",
        "Show how the devices' clocks are mapped to LSL's; exit code 1 if no agent runs.",
    ),
    _command(
        "wait-ready",
        "readiness:wait_ready",
        "Wait until all devices of the agent deliver samples; exit code 1 if they do not in time.",
    ),
    _command(
        "scan",
        "scan:scan",
        "List the devices in reach, each with the lines that add it to the settings.",
    ),
    _command(
        "test",
        "device_test:test",
        "Connect to one device, show what it sends and what is wrong; nothing is streamed.",
    ),
    _command(
        "capture",
        "capture:app",
        "Capture what a device sends, to help its driver: capture SENSOR. Or replay a capture.",
    ),
    _command(
        "doctor",
        "doctor:doctor",
        "Say what is wrong on this computer and how to mend it; exit code 1 if there are errors.",
    ),
    _hidden(
        "doctor-probe",
        "doctor:doctor_probe",
        "Be the other program of a check; used by doctor itself.",
    ),
    _command("config", "settings:app", "The settings file."),
    _command("secrets", "secrets:app", "Secrets in the keyring of the system."),
    _on_linux("service", "service:app", "The agent as a service of this user (Linux)."),
    _command("record", "record:app", "Start, watch and stop recordings."),
    _command(
        "replay",
        "replay:replay",
        "Play a recording as LSL streams, with the headers, gaps and times that were recorded.",
    ),
    _command(
        "features",
        "features:features",
        "Send beats, skin responses, breaths and more of raw streams as streams, until Ctrl-C.",
    ),
    _command("xdf", "xdf:app", "Recordings of LabRecorder (XDF files)."),
    _command("bag", "bag:app", "Bags of ROS (MCAP or SQLite); no ROS is needed."),
    _command(
        "withdraw",
        "withdrawing:withdraw",
        "Take one person out of files: shows the plan, asks, does it, and searches what is left.",
    ),
    _hidden("installation", "installation:app", "Used by the Windows installer."),
)
