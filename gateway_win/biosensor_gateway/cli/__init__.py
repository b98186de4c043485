"""The command line: ``biosensor-gateway``."""

from __future__ import annotations

import sys

from biosensor_gateway.ending import end_quietly_until_running

__all__ = ["main"]


def main() -> None:
    """Run the command line; see `biosensor_gateway.cli.app`."""
    if sys.argv[1:2] == ["run"]:
        # The commands take a second to import, and a service may be stopped as it starts.
        end_quietly_until_running()
    from biosensor_gateway.cli import app  # noqa: PLC0415 - only now

    app.main()
