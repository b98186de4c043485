"""Applies each kind of fault to a virtual server and its first wristband."""

from __future__ import annotations

from biosensor_gateway.devices.empatica_e4.simulator.server import Server
from biosensor_gateway.devices.empatica_e4.simulator.wristband import Wristband
from biosensor_gateway.simulation.faults import Fault, FaultKind


def begin(server: Server, wristband: Wristband, fault: Fault) -> None:
    """Begin a fault."""
    match fault.kind:
        case FaultKind.DROP:
            server.lose(wristband)
        case FaultKind.STALL:
            server.listener.stall()
        case FaultKind.GARBAGE:
            server.send_garbage(round(fault.value))
        case FaultKind.REFUSE:
            server.refuse()
        case FaultKind.LATE:
            server.answer_late(fault.value)
        case FaultKind.FORGET:
            server.forget_subscriptions()
        case FaultKind.RESTART:
            server.go_down()
        case FaultKind.LOW_BATTERY:
            wristband.signals.battery = fault.value / 100
        case FaultKind.OFF_BODY:
            wristband.signals.is_worn = False
        case FaultKind.DRIFT:
            wristband.crystal.set_drift(fault.value)


def end(server: Server, wristband: Wristband, kind: FaultKind) -> None:
    """End one that lasts."""
    match kind:
        case FaultKind.DROP:
            server.come_back(wristband)
        case FaultKind.STALL:
            server.listener.resume()
        case FaultKind.REFUSE:
            server.manners.refuses_binding = False
        case FaultKind.LATE:
            server.manners.late_s = 0.0
        case FaultKind.RESTART:
            server.come_up()
        case FaultKind.OFF_BODY:
            wristband.signals.is_worn = True
        case _:
            raise AssertionError(f"{kind} does not last")
