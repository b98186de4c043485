"""Lists all commands and runs the one that was given.

A new command is a function in a module here and a line in `COMMANDS`.

Exit codes: 0 done, 1 something is missing or did not work, 2 the command or
the settings are wrong.
"""

from __future__ import annotations

import errno
import sys
from functools import partial
from typing import Annotated

import typer
from typer.core import TyperGroup

from biosensor_common import liblsl, process_limits
from biosensor_common.errors import ConfigError, GatewayError, SpecError, SpecReason
from biosensor_gateway.cli.lazy_group import Deferred, LazyGroup

EXIT_FAILED, EXIT_USAGE = 1, 2

_REFUSED = frozenset({errno.EACCES, errno.EPERM, errno.EROFS, errno.ENOSPC})


def _command(name: str, place: str, *, hidden: bool = False) -> Deferred:
    return Deferred(name, f"biosensor_gateway.cli.{place}", hidden=hidden)


_hidden = partial(_command, hidden=True)
# On other systems these commands only explain why they cannot work.
_on_linux = partial(_command, hidden=sys.platform != "linux")

COMMANDS = (
    _command("run", "agent:run"),
    _command("stop", "agent:stop"),
    _command("pause", "agent:pause"),
    _command("resume", "agent:resume"),
    _command("reload", "agent:reload"),
    _command("page", "page:page"),
    _command("mark", "mark:mark"),
    _command("try", "try_out:try_out"),
    _on_linux("demo", "try_out:demo"),
    _command("status", "status:status"),
    _command("clocks", "status:clocks"),
    _command("wait-ready", "status:wait_ready"),
    _command("scan", "devices:scan"),
    _command("test", "devices:test"),
    _command("capture", "capture:app"),
    _command("doctor", "doctor:doctor"),
    _hidden("doctor-probe", "doctor:doctor_probe"),
    _command("config", "config:app"),
    _command("secrets", "secrets:app"),
    _on_linux("service", "service:app"),
    _command("record", "record:app"),
    _command("replay", "replay:replay"),
    _command("features", "features:features"),
    _command("xdf", "xdf:app"),
    _command("bag", "bag:app"),
    _command("withdraw", "withdraw:withdraw"),
    _hidden("installation", "installation:app"),
)

_root = typer.Typer(
    cls=LazyGroup,
    help="Wearable biosensors as Lab Streaming Layer outlets.",
    no_args_is_help=True,
)


def app() -> TyperGroup:
    """Return the group of all commands."""
    # `get_command` adds the options for shell completion, which `LazyGroup` alone lacks.
    group = typer.main.get_command(_root)
    assert isinstance(group, TyperGroup)
    for command in COMMANDS:
        group.add_command(command)
    return group


def main() -> None:
    """Run the command line; every expected failure is one sentence on stderr."""
    try:
        app()()
    except ConfigError as error:
        _fail(error, EXIT_USAGE)
    except SpecError as error:
        # An unknown sensor is a typing mistake; other errors of a declaration are not.
        is_mistyped = error.reason is SpecReason.UNKNOWN_SENSOR
        _fail(error, EXIT_USAGE if is_mistyped else EXIT_FAILED)
    except GatewayError as error:
        _fail(error, EXIT_FAILED)
    except (OSError, RuntimeError) as error:
        sentence = liblsl.what_is_missing(error)
        if not sentence and isinstance(error, OSError):
            sentence = refusal(error)
        if not sentence:
            raise
        _fail(sentence, EXIT_FAILED)


def refusal(error: OSError) -> str:
    """Return a sentence about what the system refuses; empty if the error is a defect of ours."""
    if error.errno in (errno.EMFILE, errno.ENFILE):
        return f"no more files can be opened: {process_limits.reason()}; {process_limits.fix()}"
    if error.errno not in _REFUSED or error.filename is None:
        return ""
    from biosensor_gateway.settings.places import SETTINGS_VARIABLE, STATE_VARIABLE  # only then

    return (
        f"{error.filename}: {error.strerror}; have it allowed, or let {STATE_VARIABLE} name "
        f"another folder and {SETTINGS_VARIABLE} another file"
    )


def _fail(error: GatewayError | str, code: int) -> None:
    sys.stderr.write(f"biosensor-gateway: {error}\n")
    raise SystemExit(code)


def _print_version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import version  # takes longer than all the rest

        typer.echo(f"biosensor-gateway {version('biosensor-gateway')}")
        raise typer.Exit


@_root.callback()
def _options(
    _version: Annotated[
        bool,
        typer.Option(
            "--version", callback=_print_version, is_eager=True, help="Print the version."
        ),
    ] = False,
) -> None:
    pass
