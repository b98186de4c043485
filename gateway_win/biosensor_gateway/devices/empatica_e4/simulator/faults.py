"""Does each fault to a virtual server and its first wristband."""

from __future__ import annotations

from types import MappingProxyType

from biosensor_gateway.devices.empatica_e4.simulator.server import Server
from biosensor_gateway.simulation.effects import Effect, Effects, lasting
from biosensor_gateway.simulation.faults import FaultKind


def _lose(server: Server) -> None:
    server.lose(server.first)


def _come_back(server: Server) -> None:
    server.come_back(server.first)


def _stall(server: Server) -> None:
    server.listener.stall()


def _resume(server: Server) -> None:
    server.listener.resume()


def _babble(server: Server, lines: float) -> None:
    server.send_garbage(round(lines))


def _write_foreign(server: Server) -> None:
    server.delivery.mishaps.foreign = True


def _write_usual(server: Server) -> None:
    server.delivery.mishaps.foreign = False


def _let_bind(server: Server) -> None:
    server.manners.refuses_binding = False


def _answer_in_time(server: Server) -> None:
    server.manners.late_s = 0.0


def _forget(server: Server, _: float) -> None:
    server.forget_subscriptions()


def _discharge(server: Server, percent: float) -> None:
    server.first.signals.battery = percent / 100


def _take_off(server: Server) -> None:
    server.first.signals.is_worn = False


def _put_on(server: Server) -> None:
    server.first.signals.is_worn = True


def _drift(server: Server, ppm: float) -> None:
    server.first.crystal.set_drift(ppm)


EFFECTS: Effects[Server] = MappingProxyType(
    {
        FaultKind.DROP: lasting(_lose, _come_back),
        FaultKind.STALL: lasting(_stall, _resume),
        FaultKind.GARBAGE: Effect(_babble),
        FaultKind.REFUSE: lasting(Server.refuse, _let_bind),
        FaultKind.LATE: Effect(Server.answer_late, _answer_in_time),
        FaultKind.FORGET: Effect(_forget),
        FaultKind.UNREADABLE: lasting(_write_foreign, _write_usual),
        FaultKind.RESTART: lasting(Server.go_down, Server.come_up),
        FaultKind.LOW_BATTERY: Effect(_discharge),
        FaultKind.OFF_BODY: lasting(_take_off, _put_on),
        FaultKind.DRIFT: Effect(_drift),
    }
)
