"""Says how the agent and its devices are now, as the status file has it."""

from __future__ import annotations

import os
import time
from collections.abc import Iterable
from typing import Any

from pylsl import local_clock

from biosensor_gateway.agent.device import Device
from biosensor_gateway.system.keep_alive import restart_facts


def snapshot(devices: Iterable[Device]) -> dict[str, Any]:
    """Describe the agent and every device of it."""
    return {
        "written": time.time(),
        # On which the clocks' `newest_s` and the streams' `last_stamp` are.
        "lsl_time": local_clock(),
        "process": os.getpid(),
        **restart_facts(os.environ),
        "devices": [device.status() for device in devices],
    }
