"""The command line: ``biosensor-gateway``."""

from biosensor_gateway.cli.app import app, main

__all__ = ["app", "main"]
