"""Help that is shown without what typer imports for other programs' help."""

from __future__ import annotations

import sys
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING

from typer.core import TyperCommand, TyperGroup

if TYPE_CHECKING:
    # The only names that typer has for them.
    from typer._click import Context, HelpFormatter

# A third of the time. Our help has no Markdown, and our tracebacks have no colours.
_SPARED = {"rich.markdown": "Markdown", "rich.traceback": "Traceback"}


class QuickGroup(TyperGroup):
    """A group of commands whose help looks as any of typer, and comes sooner."""

    def format_help(self, ctx: Context, formatter: HelpFormatter) -> None:
        """Print the help."""
        _import_help()
        super().format_help(ctx, formatter)


class QuickCommand(TyperCommand):
    """A command of which the same holds."""

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
