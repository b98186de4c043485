"""A program that is kept alive, with a standby: ``python kept_program.py RECORD``.

It appends a line to the file RECORD for whatever it does: ``stands by PROCESS``, and ``runs PROCESS
RESTARTS LAST_END``. It ends with code 0 as soon as there is the file RECORD.end, and with code 1 at
once if there is RECORD.fail.
"""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path

from biosensor_gateway.system.keep_alive import LAST_END, RESTARTS, await_turn, is_standby

RECORD = Path(sys.argv[1])


def record(*words: object) -> None:
    with RECORD.open("a", encoding="utf-8") as file:
        file.write(" ".join(str(word) for word in words) + "\n")


def main() -> None:
    if is_standby():
        record("stands by", os.getpid())
        await_turn()
    record("runs", os.getpid(), os.environ.get(RESTARTS, ""), os.environ.get(LAST_END, ""))
    if RECORD.with_suffix(".fail").exists():
        sys.exit(1)
    while not RECORD.with_suffix(".end").exists():
        time.sleep(0.01)


if __name__ == "__main__":
    main()
