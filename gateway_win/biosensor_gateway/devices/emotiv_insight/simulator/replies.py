"""Requests in, replies out, and what can go wrong on the way."""

from __future__ import annotations

import asyncio
import json
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, cast

from biosensor_gateway.devices.emotiv_insight.simulator.errors import Code, RpcError
from biosensor_gateway.devices.emotiv_insight.simulator.listener import Client
from biosensor_gateway.devices.emotiv_insight.simulator.methods import Methods

_KEPT_CALLS = 10_000
_REFUSED_METHODS = frozenset({"authorize", "createSession", "subscribe"})
_WITHOUT_BLUETOOTH = {"code": 31, "message": "Cortex may not use Bluetooth."}


@dataclass(slots=True)
class Manners:
    """How the server answers.

    Attributes
    ----------
    late_s
        Every answer is so late.
    delays_s
        Answers to a method are so much later still, and so may overtake each other.
    refusal
        Error code for whatever leads to data; None = not refused.
    is_starting
        Nothing but the version can be had yet.
    lacks_bluetooth
        The list of headsets carries the note that Bluetooth is not permitted.
    errors
        Codes for the next requests of a method.
    withheld, doubled
        Methods whose next request gets no answer, or two.
    """

    late_s: float = 0.0
    delays_s: Mapping[str, float] = field(default_factory=dict[str, float])
    refusal: int | None = None
    is_starting: bool = False
    lacks_bluetooth: bool = False
    errors: dict[str, deque[int]] = field(default_factory=dict[str, deque[int]])
    withheld: set[str] = field(default_factory=set[str])
    doubled: set[str] = field(default_factory=set[str])

    def check(self, method: str) -> None:
        """Refuse a request that is to be refused, before it has any effect.

        Raises
        ------
        RpcError
        """
        if self.is_starting and method != "getCortexInfo":
            raise RpcError(Code.STARTING, "Cortex is starting.")
        if self.refusal is not None and method in _REFUSED_METHODS:
            raise RpcError(self.refusal, "The request is refused.")
        if self.errors.get(method):
            raise RpcError(self.errors[method].popleft(), "The request has failed.")


class Replies:
    """Reads requests, has them carried out and answers them.

    Parameters
    ----------
    methods, manners
    loop
        For late answers.

    Attributes
    ----------
    calls
        Names of the methods that were asked for, in order.
    """

    def __init__(self, methods: Methods, manners: Manners, loop: asyncio.AbstractEventLoop) -> None:
        self.calls: deque[str] = deque(maxlen=_KEPT_CALLS)
        self._methods = methods
        self._manners = manners
        self._loop = loop

    def hear(self, client: Client, message: str | bytes) -> None:
        """Take one message of a client."""
        try:
            request = json.loads(message)
        except ValueError:
            self._answer(client, "", _failure(None, RpcError(Code.PARSE, "This is no JSON.")))
            return
        fields = cast("dict[str, Any]", request) if isinstance(request, dict) else {}
        method, reply = self._carry_out(client, fields)
        self._answer(client, method, reply)

    def _carry_out(self, client: Client, fields: dict[str, Any]) -> tuple[str, dict[str, Any]]:
        method, params = fields.get("method"), fields.get("params", {})
        if not isinstance(method, str) or not isinstance(params, dict):
            return "", _failure(fields.get("id"), RpcError(Code.INVALID_REQUEST, "No request."))
        self.calls.append(method)
        reply: dict[str, Any] = {"id": fields.get("id"), "jsonrpc": "2.0"}
        try:
            self._manners.check(method)
            reply["result"] = self._methods.call(method, client, cast("dict[str, Any]", params))
        except RpcError as error:
            return method, _failure(fields.get("id"), error)
        if method == "queryHeadsets" and self._manners.lacks_bluetooth:
            reply["attention"] = _WITHOUT_BLUETOOTH
        return method, reply

    def _answer(self, client: Client, method: str, reply: dict[str, Any]) -> None:
        manners = self._manners
        if method in manners.withheld:
            manners.withheld.remove(method)
            return
        delay_s = manners.late_s + manners.delays_s.get(method, 0.0)
        text = json.dumps(reply)
        for _ in range(2 if method in manners.doubled else 1):
            if delay_s:
                self._loop.call_later(delay_s, client.send, text)
            else:
                client.send(text)
        manners.doubled.discard(method)


def _failure(request_id: object, error: RpcError) -> dict[str, Any]:
    described = {"code": error.code, "message": error.message}
    return {"error": described, "id": request_id, "jsonrpc": "2.0"}
