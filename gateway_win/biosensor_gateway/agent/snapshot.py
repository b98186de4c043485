"""Says how the agent and its devices are now."""

from __future__ import annotations

import os
import time
from collections.abc import Iterable

from pylsl import local_clock

from biosensor_common.refusals import Refusals
from biosensor_gateway.agent.device import Device
from biosensor_gateway.agent.status import AgentStatus, RefusedStatus
from biosensor_gateway.system.keep_alive import restart_facts


def snapshot(
    devices: Iterable[Device], *, virtual: bool = False, own: Iterable[Refusals] = ()
) -> AgentStatus:
    """Describe the agent and every device of it.

    Parameters
    ----------
    devices
    virtual
        Whether they are.
    own
        What of the agent's own streams is not passed on.
    """
    restarts = restart_facts(os.environ)
    return AgentStatus(
        written=time.time(),
        lsl_time=local_clock(),
        process=os.getpid(),
        virtual=virtual,
        restarts=int(restarts.get("restarts", 0)),
        last_end=str(restarts.get("last_end", "")),
        refusals=[told for each in own for told in RefusedStatus.of(each)],
        devices=[device.status() for device in devices],
    )
