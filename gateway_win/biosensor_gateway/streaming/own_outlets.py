"""Makes the outlets of the agent's own streams, which no device feeds."""

from __future__ import annotations

import socket
from collections.abc import Callable
from functools import wraps
from typing import ParamSpec

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


_Given = ParamSpec("_Given")

_log = structlog.get_logger("biosensor_gateway.events")


def log_errors(method: Callable[_Given, None]) -> Callable[_Given, None]:
    """Have a function raise nothing: its first failure is logged, later ones are passed over."""
    is_told = False

    @wraps(method)
    def guarded(*given: _Given.args, **named: _Given.kwargs) -> None:
        nonlocal is_told
        try:
            method(*given, **named)
        # nothing is dropped: of sensors; what the agent wanted to tell of itself is in the log
        except Exception as error:  # noqa: BLE001 - whatever it is, samples flow on
            if not is_told:
                is_told = True
                name = method.__name__
                # nothing is dropped: as above
                _log.exception("an event is not announced", of=name, error=str(error))

    return guarded
