"""Serves one request in a process of its own: one question, one answer.

A library may block for long, take one configuration for the life of a process, or end the
process that it is in. So whatever is asked of it is asked in a process of its own. The
request is one line of JSON on stdin, the answer one line on stdout::

    {"role": "find", "config": "[lab]...", "source_id": "doctor-5f", "timeout_s": 4}
    {"found": true}

The process ends by itself after ``life_s`` at the latest, and reads stdin no further: on
Windows, libraries that are loaded wait for whoever reads from it.
"""

from __future__ import annotations

import json
import os
import sys
import threading
from collections.abc import Callable, Mapping
from typing import Any

Request = Mapping[str, Any]


def serve(roles: Mapping[str, Callable[[Request], None]]) -> None:
    """Do what stdin says, and end the process."""
    request: dict[str, Any] = json.loads(sys.stdin.readline())
    life = threading.Timer(request["life_s"], os._exit, args=(1,))
    life.daemon = True
    life.start()
    roles[request["role"]](request)
    # Threads of libraries that wait for the network would hold up the end.
    os._exit(0)


def answer(content: object) -> None:
    """Send the answer."""
    sys.stdout.write(json.dumps(content) + "\n")
    sys.stdout.flush()
