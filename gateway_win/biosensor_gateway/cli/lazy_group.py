"""A group of commands that imports only the command that is given.

Its list of commands shows the beginning of each command's docstring, which is read from the
module's code without running it, and help leaves out what typer imports for other programs' help.
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


# A third of the time. Our help has no Markdown, and our tracebacks have no colours.
_SPARED = {"rich.markdown": "Markdown", "rich.traceback": "Traceback"}


class QuickGroup(TyperGroup):
    """A group of commands whose help looks as any of typer, and comes sooner."""

    def format_help(self, ctx: Context, formatter: HelpFormatter) -> None:
        """Print the help."""
        _import_help()
        super().format_help(ctx, formatter)


class LazyGroup(QuickGroup):
    """A group of `Deferred` commands."""

    def list_commands(self, ctx: Context) -> list[str]:
        """Return the names of all commands; whoever asks for them shows their help, too."""
        for command in self.commands.values():
            if isinstance(command, Deferred):
                command.help = command.first_lines()
        return super().list_commands(ctx)


class QuickCommand(TyperCommand):
    """A command whose help comes as soon."""

    def format_help(self, ctx: Context, formatter: HelpFormatter) -> None:
        """Print the help."""
        _import_help()
        super().format_help(ctx, formatter)


def _import_help() -> None:
    """Import typer's help with stand-ins for two classes; other importers get the real ones."""
    missing = {name: part for name, part in _SPARED.items() if name not in sys.modules}
    sys.modules.update({name: _stand_in(name, part) for name, part in missing.items()})
    try:
        import_module("typer.rich_utils")
    finally:
        for name in missing:
            del sys.modules[name]


def _stand_in(name: str, part: str) -> ModuleType:
    """Return a module with a class that makes instances of the real one."""

    def make(_class: type, *arguments: object, **options: object) -> object:
        return getattr(import_module(name), part)(*arguments, **options)

    module = ModuleType(name)
    setattr(module, part, type(part, (), {"__new__": make}))
    return module


class Deferred(TyperCommand):
    """Stands for a command, or for a group of commands, in the list of all commands.

    Parameters
    ----------
    name
        As it is typed.
    place
        ``module:attribute`` of the function, or of the Typer of a group, whose help is the
        docstring of a function `GROUP`.
    hidden
        Whether the list leaves it out.
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
            return typer.main.get_group(found)
        alone = typer.Typer(add_completion=False)
        alone.command(self.name, cls=QuickCommand)(found)
        return typer.main.get_command(alone)

    def first_lines(self) -> str:
        """Return the first paragraph of its help, without importing it."""
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
        """Import the command, and return its own context, in which it is then invoked."""
        return self.load().make_context(info_name, args, parent, **extra)
