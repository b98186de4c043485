"""By what a virtual device is reached, and which untidiness that makes impossible."""

from __future__ import annotations

from collections.abc import Mapping
from enum import Enum, unique
from types import MappingProxyType

from biosensor_gateway.simulation.faults import Kind, Untidiness

_IN_ORDER = "what carries its bytes keeps their order"
_HELD_BY_HOST = "nothing but the computer itself holds its bytes up for seconds, as when it sleeps"
_NO_NAME = "nobody finds it by a name on the air"
_NO_ADDRESS = "its settings say where it is, and that is not asked of the air"


@unique
class Link(Enum):
    """What lies between a device and its driver."""

    BLUETOOTH_LE = "Bluetooth LE"
    SERIAL = "a serial port"
    """Also that of Bluetooth Classic."""
    TCP = "TCP"
    WEB_SOCKET = "a WebSocket"
    UDP = "UDP"


IMPOSSIBLE: Mapping[Link, Mapping[Kind, str]] = MappingProxyType(
    {
        Link.BLUETOOTH_LE: {
            Untidiness.OVERTAKEN: "a link of Bluetooth LE repeats a packet until it is "
            "acknowledged, before it sends the next one",
            Untidiness.GLUED: "a notification comes as a whole and by itself",
        },
        Link.SERIAL: {
            Untidiness.BUNDLED: _HELD_BY_HOST,
            Untidiness.OVERTAKEN: _IN_ORDER,
            Untidiness.NAMELESS: _NO_NAME,
            Untidiness.READDRESSED: _NO_ADDRESS,
        },
        Link.TCP: {
            Untidiness.BUNDLED: _HELD_BY_HOST,
            Untidiness.OVERTAKEN: _IN_ORDER,
            Untidiness.NAMELESS: _NO_NAME,
            Untidiness.READDRESSED: _NO_ADDRESS,
        },
        Link.WEB_SOCKET: {
            Untidiness.BUNDLED: _HELD_BY_HOST,
            Untidiness.OVERTAKEN: _IN_ORDER,
            Untidiness.GLUED: "a message of a WebSocket comes as a whole and by itself",
            Untidiness.NAMELESS: _NO_NAME,
            Untidiness.READDRESSED: _NO_ADDRESS,
        },
        Link.UDP: {
            Untidiness.BUNDLED: _HELD_BY_HOST,
            Untidiness.GLUED: "a datagram comes as a whole and by itself",
            Untidiness.NAMELESS: _NO_NAME,
            Untidiness.READDRESSED: "who it is says its number in what it sends, whatever the "
            "address",
        },
    }
)
"""By link, what nothing on it can do, and why."""
