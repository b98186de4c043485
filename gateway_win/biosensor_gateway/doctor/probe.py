"""The other program of a check: LSL in a process of its own.

liblsl takes one configuration for the life of a process, may block for long, and may end
the process that it is in. So whatever is asked of it is asked here. The request is one
line of JSON on stdin, the answer one line on stdout::

    {"role": "find", "config": "[lab]...", "source_id": "doctor-5f", "timeout_s": 4}
    {"found": true}

It ends by itself after ``life_s`` at the latest, and reads stdin no further: on Windows,
libraries that are loaded wait for whoever reads from it.
"""

from __future__ import annotations

import json
import os
import sys
import threading
import time
from collections.abc import Callable, Mapping
from typing import Any

Request = Mapping[str, Any]


def main() -> None:
    """Do what stdin says."""
    request: dict[str, Any] = json.loads(sys.stdin.readline())
    life = threading.Timer(request["life_s"], os._exit, args=(1,))
    life.daemon = True
    life.start()
    # This module is also imported by the program that asks.
    import pylsl  # noqa: PLC0415

    pylsl.set_config_content(request["config"])
    _ROLES[request["role"]](request)
    # Threads of liblsl that wait for the network would hold up the end.
    os._exit(0)


def _answer(content: object) -> None:
    sys.stdout.write(json.dumps(content) + "\n")
    sys.stdout.flush()


def _offer(request: Request) -> None:
    """Have an outlet until this process is ended."""
    import pylsl  # noqa: PLC0415

    source_id = request["source_id"]
    outlet = pylsl.StreamOutlet(pylsl.StreamInfo(source_id, "Doctor", 1, 0.0, "float32", source_id))
    _answer({"open": True})
    time.sleep(request["life_s"])
    del outlet


def _find(request: Request) -> None:
    """Look for a stream."""
    import pylsl  # noqa: PLC0415

    found = pylsl.resolve_byprop("source_id", request["source_id"], 1, request["timeout_s"])
    _answer({"found": bool(found)})


def _survey(request: Request) -> None:
    """Look at all streams."""
    from biosensor_gateway.doctor.survey import survey  # noqa: PLC0415

    _answer(survey(request["search_s"], request["listen_s"], request["listen_until_s"]))


_ROLES: dict[str, Callable[[Request], None]] = {
    "offer": _offer,
    "find": _find,
    "survey": _survey,
}

if __name__ == "__main__":
    main()
