"""Starts the command line of the agent: the program that PyInstaller freezes."""

from __future__ import annotations

from multiprocessing import freeze_support

from biosensor_gateway.cli import main

if __name__ == "__main__":
    freeze_support()
    main()
