"""Subscribes to one sensor in the OpenEarable app, and returns its values as lines.

The app is a WebSocket server with JSON messages: numbered requests with their answers, and events
[1]_. An event of a subscription contains the sensor's time and values, which become an array.

.. [1] https://github.com/OpenEarable/app, ``open_wearable/docs/connectors/websocket-ipc-api.md``;
   the values' layout is in ``websocket_ipc_server.dart`` beside it.
"""

from __future__ import annotations

import asyncio
import json
from collections import deque
from itertools import count
from typing import Any, NamedTuple, cast

from biosensor_common.errors import (
    ProtocolError,
    ProtocolReason,
    TransportError,
    TransportReason,
)
from biosensor_gateway.transports.link import Received
from biosensor_gateway.transports.tap import text_link_of
from biosensor_gateway.transports.websocket import WebSocketLink

ANSWER_LIMIT_S = 5.0
_EXPONENTS = {"s": 0, "ms": -3, "us": -6, "ns": -9}
_Object = dict[str, Any]


class Asked(NamedTuple):
    """The sensor to subscribe to in the app."""

    sensor: str  # Name or id of the sensor in the app.
    wearable: str  # Name or id of the device; empty for the only one connected to the app.
    time_unit: str


class OpenEarableLink:
    """A subscription; each read is a JSON array of time and values, or another message."""

    in_messages = True

    def __init__(self, url: str, asked: Asked) -> None:
        self._link = text_link_of(WebSocketLink(url))
        self._where, self._asked = f"the OpenEarable app at {url}", asked
        self._numbers = count(1)
        self._subscription: object = None
        # The first values may arrive before the answer that identifies the subscription.
        self._early: deque[Received] = deque()
        self.close = self._link.close

    async def open(self) -> None:
        """Connect, select wearable and sensor, and subscribe.

        Raises
        ------
        TransportError
            As for a WebSocket; ``ABSENT`` without a wearable, ``SILENT`` without an answer.
        ProtocolError
            ``REFUSED`` or ``UNSUPPORTED`` if the sensor is refused or not available.
        """
        await self._link.open()
        wearable = self._wearable(_objects(await self._ask("list_connected")))
        device = {"device_id": wearable.get("device_id")}
        listed = await self._ask("invoke_action", **device, action="list_sensors")
        sensor = self._sensor(_objects(listed))
        args = {"sensor_id": sensor.get("sensor_id")}
        answer = await self._ask("subscribe", **device, stream="sensor_values", args=args)
        (subscription,) = _objects([answer]) or ({},)
        self._subscription = subscription.get("subscription_id")

    async def read(self) -> Received:
        """Wait for the next values.

        Raises
        ------
        TransportError
            ``LOST`` if the connection or the subscription has ended.
        """
        while True:
            received = self._early.popleft() if self._early else await self._next()
            message = _object(received.data)
            if message is None:
                return received
            if message.get("subscription_id") != self._subscription:
                continue
            event, data = message.get("event"), message.get("data")
            if event == "stream" and isinstance(data, dict):
                return received._replace(data=_array(cast("_Object", data)))
            if event == "stream":
                return received
            why = _error(message) or "is the wearable still connected to it?"
            text = f"{self._where} has stopped sending {self._asked.sensor}; {why}"
            raise TransportError(TransportReason.LOST, text)

    async def send(self, text: str) -> None:
        """Send a command."""
        await self._link.send(text)

    async def _next(self) -> Received:
        text, arrival_s = await self._link.read()
        return Received(text.encode("utf-8", "surrogatepass"), arrival_s)

    async def _ask(self, method: str, **params: object) -> object:
        number = next(self._numbers)
        await self._link.send(json.dumps({"id": number, "method": method, "params": params}))
        try:
            async with asyncio.timeout(ANSWER_LIMIT_S):
                answer = await self._answer(number)
        except TimeoutError as error:
            message = f"{self._where} does not answer {method} within {ANSWER_LIMIT_S:.0f} s"
            raise TransportError(TransportReason.SILENT, message) from error
        if "error" in answer:
            message = f"{self._where} refuses {method}: {_error(answer)}"
            raise ProtocolError(ProtocolReason.REFUSED, message)
        return answer.get("result")

    async def _answer(self, number: int) -> _Object:
        while True:
            received = await self._next()
            message = _object(received.data)
            if message is not None and message.get("id") == number:
                return message
            if message is not None and "subscription_id" in message:
                self._early.append(received)

    def _wearable(self, connected: list[_Object]) -> _Object:
        wanted = self._asked.wearable
        found = [each for each in connected if not wanted or _is_called(each, "device_id", wanted)]
        if len(found) == 1:
            return found[0]
        names = _names(connected)
        if not connected or not found:
            there = f"only {names} is" if connected else "no wearable is"
            message = f"{self._where}: {there} connected to it; connect yours there"
            raise TransportError(TransportReason.ABSENT, message)
        message = (
            f"{self._where}: {names} are connected to it; set openearable_wearable to one of them"
        )
        raise ProtocolError(ProtocolReason.REFUSED, message)

    def _sensor(self, sensors: list[_Object]) -> _Object:
        wanted = self._asked.sensor
        found = [each for each in sensors if _is_called(each, "sensor_id", wanted)]
        if not found:
            message = (
                f"{self._where}: the wearable has no sensor {wanted}; it has {_names(sensors)}"
            )
            raise ProtocolError(ProtocolReason.UNSUPPORTED, message)
        exponent = found[0].get("timestamp_exponent")
        if exponent != _EXPONENTS[self._asked.time_unit]:
            units = {each: unit for unit, each in _EXPONENTS.items()}
            told = units.get(cast("int", exponent), f"10^{exponent} s")
            message = (
                f"{self._where}: the time of {wanted} is in {told}, but columns says "
                f"[{self._asked.time_unit}]"
            )
            raise ProtocolError(ProtocolReason.UNSUPPORTED, message)
        return found[0]


def _object(data: bytes) -> _Object | None:
    try:
        message: object = json.loads(data)
    except (ValueError, RecursionError):
        return None
    return cast("_Object", message) if isinstance(message, dict) else None


def _objects(result: object) -> list[_Object]:
    listed = cast("list[object]", result) if isinstance(result, list) else []
    return [cast("_Object", each) for each in listed if isinstance(each, dict)]


def _array(data: _Object) -> bytes:
    values = data.get("values")
    listed = cast("list[object]", values) if isinstance(values, list) else []
    return json.dumps([data.get("timestamp"), *listed]).encode()


def _is_called(each: _Object, key: str, wanted: str) -> bool:
    return wanted in {str(each.get(key)), str(each.get("name"))}


def _names(listed: list[_Object]) -> str:
    return ", ".join(str(each.get("name")) for each in listed) or "none"


def _error(message: _Object) -> str:
    error = message.get("error")
    return str(cast("_Object", error).get("message")) if isinstance(error, dict) else ""
