"""Commands that are imported when they are called: each brings libraries of its own."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

import typer
from typer.core import TyperCommand

from biosensor_gateway.cli.quick_help import QuickCommand

if TYPE_CHECKING:
    # The only names that typer has for them.
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
