"""Writes the agent's status once a second, for ``status`` and for scripts, and reads it."""

from __future__ import annotations

import contextlib
import json
import os
import time
from collections.abc import Iterable
from dataclasses import asdict
from math import isfinite
from pathlib import Path
from typing import Any

from pylsl import local_clock

from biosensor_common import naming
from biosensor_common.errors import ConfigError, ConfigReason
from biosensor_gateway.agent.supervisor import Supervisor
from biosensor_gateway.streaming.sink import DeviceSink
from biosensor_gateway.system import state_file

STATUS_FILE = "status.json"
STALE_AFTER_S = 5.0


def snapshot(devices: Iterable[tuple[Supervisor, DeviceSink]]) -> dict[str, Any]:
    """Describe every device: state, last error, clock and the counters of each stream."""
    return {
        "written": time.time(),
        # On which the clocks' `newest_s` and the streams' `last_stamp` are.
        "lsl_time": local_clock(),
        "process": os.getpid(),
        "devices": [_device(supervisor, sink) for supervisor, sink in devices],
    }


def _device(supervisor: Supervisor, sink: DeviceSink) -> dict[str, Any]:
    identity, clock = sink.identity, asdict(sink.clock_state)
    silent = {naming.source_id(identity, data_name) for data_name in sink.silent}
    return {
        **asdict(identity),
        "state": supervisor.state.value,
        "paused": sink.is_paused,
        "connections": supervisor.connections,
        "error": supervisor.last_error,
        "dropped_bytes": sink.dropped_bytes,
        # JSON knows no NaN; before the first packet there is nothing to say.
        "clock": clock if isfinite(clock["offset_s"]) else None,
        "streams": {
            source: {
                **asdict(counters),
                "rate_hz": sink.nominal_rates[source],
                "silent": source in silent,
            }
            for source, counters in sink.counters.items()
        },
    }


def write_status(folder: Path, status: dict[str, Any]) -> None:
    """Replace the status file.

    Raises
    ------
    OSError
        The folder cannot be written.
    """
    state_file.replace(folder / STATUS_FILE, json.dumps(status, indent=1))


def read_status(folder: Path) -> dict[str, Any]:
    """Read what a running agent wrote last.

    Raises
    ------
    ConfigError
        ``NOT_FOUND`` if no agent runs, ``UNREADABLE`` if its file is damaged.
    """
    path = folder / STATUS_FILE
    try:
        status: dict[str, Any] = json.loads(state_file.read(path))
        age = time.time() - float(status["written"])
        status["devices"] = list(status["devices"])
    except FileNotFoundError as error:
        message = "no agent is running; start one with: biosensor-gateway run"
        raise ConfigError(ConfigReason.NOT_FOUND, message) from error
    except (OSError, ValueError, KeyError, TypeError, OverflowError, RecursionError) as error:
        message = f"{path}: the status file cannot be read ({error}); restart the agent"
        raise ConfigError(ConfigReason.UNREADABLE, message) from error
    if age > STALE_AFTER_S:
        message = f"the agent last reported {age:.0f} s ago; start it with: biosensor-gateway run"
        raise ConfigError(ConfigReason.NOT_FOUND, message)
    return status


def remove_status(folder: Path) -> None:
    """Say that the agent has ended; a file that cannot be removed says so by its age."""
    with contextlib.suppress(OSError):
        (folder / STATUS_FILE).unlink()
