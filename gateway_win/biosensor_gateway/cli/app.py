"""Lists all commands and runs the one that was given.

A new command is a function in a module here and a line in `COMMANDS`.

Exit codes: 0 done, 1 something is missing or did not work, 2 the command or
the settings are wrong.
"""

from __future__ import annotations

import errno
import inspect
import sys
from collections.abc import Sequence
from functools import partial
from importlib import import_module
from importlib.abc import InspectLoader
from importlib.util import find_spec
from itertools import pairwise
from pathlib import Path
from types import CodeType, ModuleType
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup

from biosensor_common import liblsl, process_limits
from biosensor_common.errors import ConfigError, GatewayError, SpecError, SpecReason

if TYPE_CHECKING:
    from typer._click import Command, Context, HelpFormatter

# typer's help imports these, which takes a third of its time. We do not need them: our help has no
# Markdown, and our tracebacks have no colours.
_SPARED = {"rich.markdown": "Markdown", "rich.traceback": "Traceback"}


class QuickGroup(TyperGroup):
    """A group of commands with typer's usual help, imported faster."""

    def format_help(self, ctx: Context, formatter: HelpFormatter) -> None:
        """Print the help."""
        _import_help()
        super().format_help(ctx, formatter)


class LazyGroup(QuickGroup):
    """A group of `Deferred` commands."""

    def list_commands(self, ctx: Context) -> list[str]:
        """Return the names of all commands."""
        # Only the list of commands asks for the names, and it shows the help of each.
        for command in self.commands.values():
            if isinstance(command, Deferred):
                command.help = command.first_lines()
        return super().list_commands(ctx)


class QuickCommand(TyperCommand):
    """A command with typer's usual help, imported faster."""

    def format_help(self, ctx: Context, formatter: HelpFormatter) -> None:
        """Print the help."""
        _import_help()
        super().format_help(ctx, formatter)


def _with_joined_lines(command: Command) -> Command:
    """Join the lines of each paragraph of the help, because a console is narrower than our code."""
    if command.help:
        paragraphs = inspect.cleandoc(command.help).split("\n\n")
        command.help = "\n\n".join(" ".join(each.splitlines()) for each in paragraphs)
    if isinstance(command, TyperGroup):
        for each in command.commands.values():
            _with_joined_lines(each)
    return command


def _import_help() -> None:
    """Import typer's help with lazy placeholders for two classes.

    Modules that are imported later get the real ones.
    """
    missing = {name: part for name, part in _SPARED.items() if name not in sys.modules}
    sys.modules.update({name: _placeholder(name, part) for name, part in missing.items()})
    try:
        import_module("typer.rich_utils")
    finally:
        for name in missing:
            del sys.modules[name]


def _placeholder(name: str, part: str) -> ModuleType:
    """Return a module whose class imports the real one when it is called."""

    def make(_class: type, *arguments: object, **options: object) -> object:
        return getattr(import_module(name), part)(*arguments, **options)

    module = ModuleType(name)
    setattr(module, part, type(part, (), {"__new__": make}))
    return module


class Deferred(TyperCommand):
    """A command or a group of commands that is imported when it is run.

    Parameters
    ----------
    place
        ``module:attribute`` of a command's function or of a group's Typer. A group's help is the
        docstring of its function `GROUP`.
    """

    GROUP = "_group"

    def __init__(self, name: str, place: str, *, hidden: bool = False) -> None:
        super().__init__(name, hidden=hidden)
        self.place = place

    def load(self) -> Command:
        """Import the command."""
        module, _, attribute = self.place.partition(":")
        found = getattr(import_module(module), attribute)
        if isinstance(found, typer.Typer):
            return _with_joined_lines(typer.main.get_group(found))
        alone = typer.Typer(add_completion=False)
        alone.command(self.name, cls=QuickCommand)(found)
        return _with_joined_lines(typer.main.get_command(alone))

    def first_lines(self) -> str:
        """Return the first paragraph of the command's help, without importing the command."""
        module, _, attribute = self.place.partition(":")
        spec = find_spec(module)
        if spec is None or not isinstance(spec.loader, InspectLoader):
            return ""
        code = spec.loader.get_code(module)
        for part in code.co_consts if code else ():
            if isinstance(part, CodeType) and part.co_name in (attribute, self.GROUP):
                text = part.co_consts[0] if part.co_consts else ""
                if isinstance(text, str):
                    return inspect.cleandoc(text).partition("\n\n")[0]
        return ""

    def make_context(
        self,
        info_name: str | None,
        args: list[str],
        parent: Context | None = None,
        **extra: Any,  # noqa: ANN401 - as in typer
    ) -> Context:
        """Import the command, and return the context in which it is invoked."""
        return self.load().make_context(info_name, args, parent, **extra)


EXIT_FAILED, EXIT_USAGE = 1, 2
_NO_THREAD = "can't start new thread"
_NO_MORE = (
    "the system starts no more threads or programs for this user; end other programs, or raise the "
    "limit (on Linux: ulimit -u, or pids of the container)"
)
# What the system refuses because of the file that was named, not because of a defect of ours.
_REFUSED = frozenset(
    {
        *(errno.EACCES, errno.EPERM, errno.EROFS, errno.ENOSPC, errno.EDQUOT),
        *(errno.ENAMETOOLONG, errno.ELOOP, errno.ENOTDIR, errno.EIO),
    }
)


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
    _refuse_empty(sys.argv)
    try:
        app()()
    except SystemExit as end:
        if end.code == process_limits.INTERRUPTED:
            # What waits for the network in a pool of threads would hold up the exit.
            process_limits.end_within(process_limits.INTERRUPTED_S, process_limits.INTERRUPTED)
        raise
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
        sentence = sentence or refusal(error)
        if not sentence:
            raise
        _fail(sentence, EXIT_FAILED)


def _refuse_empty(arguments: Sequence[str]) -> None:
    """Exit if an argument is empty, as where a script's variable is not set.

    It would mean "not given": real sensors instead of virtual ones, or this folder.
    """
    for before, argument in pairwise(arguments):
        if not argument or (argument.startswith("--") and argument.endswith("=")):
            name = argument.removesuffix("=") or before
            _fail(f"what follows {name!r} is empty; leave it out, or set the variable", EXIT_USAGE)


def refusal(error: OSError | RuntimeError) -> str:
    """Return a sentence about what the system refuses; empty if the error is a defect of ours."""
    if isinstance(error, RuntimeError):
        return _NO_MORE if str(error) == _NO_THREAD else ""
    if error.errno == errno.EAGAIN:
        return _NO_MORE
    if error.errno in (errno.EMFILE, errno.ENFILE):
        return f"no more files can be opened: {process_limits.reason()}; {process_limits.fix()}"
    if error.errno not in _REFUSED or error.filename is None:
        return ""
    from biosensor_gateway.settings import places  # only then

    what = f"{error.filename}: {error.strerror}"
    own = places.settings_path().parent, places.state_folder()
    refused = Path(error.filename).absolute()
    if any(refused.is_relative_to(each) or each.is_relative_to(refused) for each in own):
        return (
            f"{what}; get permission to use it, or set {places.STATE_VARIABLE} to "
            f"another folder and {places.SETTINGS_VARIABLE} to another file"
        )
    return f"{what}; choose another file or folder, or get permission to use this one"


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
