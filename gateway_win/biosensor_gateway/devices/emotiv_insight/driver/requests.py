"""Builds the requests to Cortex."""

from __future__ import annotations

import json
from collections.abc import Mapping

from biosensor_gateway.settings.secrets import Secret


def request_text(request_id: int, method: str, params: Mapping[str, object] | None) -> str:
    """Return a request of JSON-RPC 2.0.

    Parameters
    ----------
    params
        What JSON knows, and secrets: they are revealed here and nowhere earlier, so
        that no traceback with variables shows them.
    """
    return json.dumps(
        {"jsonrpc": "2.0", "id": request_id, "method": method, "params": dict(params or {})},
        separators=(",", ":"),
        default=_revealed,
    )


def _revealed(value: object) -> str:
    if not isinstance(value, Secret):
        raise TypeError(f"{type(value).__name__} has no place in a request")
    return value.reveal()
