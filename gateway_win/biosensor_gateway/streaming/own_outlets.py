"""Makes the outlets of the agent's own streams, which no device feeds."""

from __future__ import annotations

import socket

import structlog

from biosensor_common.refusal import Refusal
from biosensor_common.refusals import Refusals
from biosensor_common.spec import DeviceIdentity, DeviceInfo
from biosensor_gateway.streaming.gateway import GATEWAY
from biosensor_gateway.streaming.outlets import Outlet
from biosensor_gateway.system.clock import LSL_CLOCK, Clock


def own_outlet(data_name: str, clock: Clock = LSL_CLOCK) -> Outlet:
    """Make the outlet of a stream that the agent cannot do without.

    Raises
    ------
    RuntimeError
        LSL has no port for it.
    OSError, ValueError
        This computer tells no name, or one that is no text.
    """
    identity = DeviceIdentity(GATEWAY.name, socket.gethostname())
    return Outlet(GATEWAY.stream(data_name), identity, DeviceInfo(model=GATEWAY.model), clock)


def spare_outlet(data_name: str, refusals: Refusals, clock: Clock = LSL_CLOCK) -> Outlet | None:
    """Make the outlet of a stream that devices go on without; what keeps it away is reported."""
    try:
        return own_outlet(data_name, clock)
    except (OSError, RuntimeError, ValueError):
        log = structlog.get_logger(f"biosensor_gateway.{data_name}")
        refusals.refuse(Refusal.NO_OUTLET, about=data_name, name=data_name)
        log.exception(f"there is no stream of {data_name}")
        return None
