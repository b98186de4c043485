"""Applies each kind of fault to a virtual Cortex."""

from __future__ import annotations

from biosensor_gateway.devices.emotiv_insight.simulator.service import Service
from biosensor_gateway.simulation.faults import Fault, FaultKind


def begin(service: Service, fault: Fault) -> None:
    """Begin a fault."""
    match fault.kind:
        case FaultKind.DROP:
            service.drop()
        case FaultKind.STALL:
            service.listener.stall()
        case FaultKind.GARBAGE:
            service.send_garbage(round(fault.value))
        case FaultKind.REFUSE:
            service.refuse()
        case FaultKind.LATE:
            service.delay(fault.value)
        case FaultKind.FORGET:
            service.sessions.forget_subscriptions()
        case FaultKind.RESTART:
            service.go_down()
        case FaultKind.LOW_BATTERY:
            service.set_battery(round(fault.value))
        case FaultKind.OFF_BODY:
            service.set_worn(is_worn=False)
        case FaultKind.DRIFT:
            service.set_drift(fault.value)


def end(service: Service, kind: FaultKind) -> None:
    """End one that lasts."""
    match kind:
        case FaultKind.DROP:
            service.restore()
        case FaultKind.STALL:
            service.listener.resume()
        case FaultKind.REFUSE:
            service.manners.refusal = None
        case FaultKind.LATE:
            service.manners.late_s = 0.0
        case FaultKind.RESTART:
            service.come_up()
        case FaultKind.OFF_BODY:
            service.set_worn(is_worn=True)
        case _:
            raise AssertionError(f"{kind} does not last")
