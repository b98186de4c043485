"""Does each fault to a virtual Cortex."""

from __future__ import annotations

from types import MappingProxyType

from biosensor_gateway.devices.emotiv_insight.simulator.service import Service
from biosensor_gateway.simulation.effects import Effect, Effects, lasting
from biosensor_gateway.simulation.faults import FaultKind


def _stall(service: Service) -> None:
    service.listener.stall()


def _resume(service: Service) -> None:
    service.listener.resume()


def _babble(service: Service, messages: float) -> None:
    service.send_garbage(round(messages))


def _send_unannounced(service: Service) -> None:
    service.mishaps.unannounced = True


def _send_announced(service: Service) -> None:
    service.mishaps.unannounced = False


def _comply(service: Service) -> None:
    service.manners.refusal = None


def _answer_in_time(service: Service) -> None:
    service.manners.late_s = 0.0


def _forget(service: Service, _: float) -> None:
    service.sessions.forget_subscriptions()


def _discharge(service: Service, percent: float) -> None:
    service.set_battery(round(percent))


def _take_off(service: Service) -> None:
    service.set_worn(is_worn=False)


def _put_on(service: Service) -> None:
    service.set_worn(is_worn=True)


EFFECTS: Effects[Service] = MappingProxyType(
    {
        FaultKind.DROP: lasting(Service.drop, Service.restore),
        FaultKind.STALL: lasting(_stall, _resume),
        FaultKind.GARBAGE: Effect(_babble),
        FaultKind.REFUSE: lasting(Service.refuse, _comply),
        FaultKind.LATE: Effect(Service.delay, _answer_in_time),
        FaultKind.FORGET: Effect(_forget),
        FaultKind.UNREADABLE: lasting(_send_unannounced, _send_announced),
        FaultKind.RESTART: lasting(Service.go_down, Service.come_up),
        FaultKind.LOW_BATTERY: Effect(_discharge),
        FaultKind.OFF_BODY: lasting(_take_off, _put_on),
        FaultKind.DRIFT: Effect(Service.set_drift),
    }
)
