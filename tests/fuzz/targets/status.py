"""``status.json``, as ``status`` reads it: a mapping, or refused with a ConfigError."""

from __future__ import annotations

import json

from biosensor_common.errors import ConfigError
from biosensor_gateway.agent.status_file import STATUS_FILE, read_status
from tests.fuzz.contract import ensure
from tests.fuzz.scratch import folder, written


def check(data: bytes) -> None:
    """Read the file."""
    written(STATUS_FILE, data)
    try:
        status = read_status(folder())
    except ConfigError as error:
        ensure(str(error).isprintable(), "it cannot be printed", str(error))
        return
    ensure("written" in status, "nobody knows how old it is", status)
    json.dumps(status)
