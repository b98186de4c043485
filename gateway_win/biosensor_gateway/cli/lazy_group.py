"""A group of commands that imports only the command that is run.

The list of commands shows the first paragraph of each command's docstring. It is read from the
module's compiled code, without importing the module.
"""

from __future__ import annotations

import inspect
import sys
from importlib import import_module
from importlib.abc import InspectLoader
from importlib.util import find_spec
from types import CodeType, ModuleType
from typing import TYPE_CHECKING, Any

import typer
from typer.core import TyperCommand, TyperGroup

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
    name
        The command's name.
    place
        ``module:attribute`` of a command's function or of a group's Typer. A group's help is the
        docstring of its function `GROUP`.
    hidden
        Whether the list of commands leaves it out.
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
