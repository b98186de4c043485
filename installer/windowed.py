"""Starts the program of the Start menu, which has no console; PyInstaller freezes it, too."""

from __future__ import annotations

import sys

from biosensor_gateway.system.windowed import main

if __name__ == "__main__":
    sys.exit(main())
