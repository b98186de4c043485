"""The errors of a virtual Cortex."""

from __future__ import annotations

from enum import IntEnum


class Code(IntEnum):
    """Error codes of the API."""

    NO_HEADSET = -32001
    WRONG_LICENCE = -32002
    HEADSET_UNAVAILABLE = -32004
    SESSION_EXISTS = -32005
    NO_LICENCE = -32006
    NO_SESSION = -32007
    INVALID_TOKEN = -32014
    EXPIRED_TOKEN = -32015
    NO_STREAM = -32016
    SESSION_LIMIT = -32019
    WRONG_CREDENTIALS = -32021
    NOT_LOGGED_IN = -32033
    NO_ACCESS_RIGHT = -32102
    STARTING = -32122
    INVALID_REQUEST = -32600
    UNKNOWN_METHOD = -32601
    INVALID_PARAMS = -32602
    INTERNAL = -32603
    PARSE = -32700


class RpcError(Exception):
    """A request that is answered with an error.

    Parameters
    ----------
    code, message
        As they go over the wire.
    """

    def __init__(self, code: int, message: str) -> None:
        super().__init__(message)
        self.code = int(code)
        self.message = message
