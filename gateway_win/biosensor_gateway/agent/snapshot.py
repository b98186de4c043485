"""Says how the agent and its devices are now."""

from __future__ import annotations

import os
import time
from collections.abc import Iterable

from pylsl import local_clock

from biosensor_gateway.agent.device import Device
from biosensor_gateway.agent.status import AgentStatus
from biosensor_gateway.system.keep_alive import restart_facts


def snapshot(devices: Iterable[Device], *, virtual: bool = False) -> AgentStatus:
    """Describe the agent and every device of it.

    Parameters
    ----------
    devices
    virtual
        Whether they are.
    """
    restarts = restart_facts(os.environ)
    return AgentStatus(
        written=time.time(),
        lsl_time=local_clock(),
        process=os.getpid(),
        virtual=virtual,
        restarts=int(restarts.get("restarts", 0)),
        last_end=str(restarts.get("last_end", "")),
        devices=[device.status() for device in devices],
    )
