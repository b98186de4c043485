"""``python -m tests.gate ARGUMENTS``: pytest, and a second look at the few that failed."""

from __future__ import annotations

import sys
from pathlib import Path

from tests.gate.second_look import run

if __name__ == "__main__":
    sys.exit(run(sys.argv[1:], Path("build")))
