"""Messages that no client should trip over."""

from __future__ import annotations

import json

import numpy as np

_STRANGER = "00000000-0000-0000-0000-000000000000"


def damaged_message(rng: np.random.Generator, session_id: str) -> str | bytes:
    """One damaged message.

    Parameters
    ----------
    rng
        Chooses the kind of damage.
    session_id
        A session of the client that gets it, so that only the damage is wrong.
    """
    eeg: list[object] = [1, 0, 1, 1, 1, 1, 1, 0, 0, []]
    sample: dict[str, object] = {"eeg": eeg, "sid": session_id, "time": 1.0}
    intact = json.dumps(sample)
    return (
        intact[: len(intact) // 2],
        intact.replace("[1, 0, 1,", "[1, 0, NaN,"),
        json.dumps(sample | {"eeg": eeg[:4]}),
        json.dumps(sample | {"eeg": [1, 0, "x", *eeg[3:]]}),
        json.dumps({"eeg": eeg, "sid": session_id}),
        json.dumps(sample | {"sid": _STRANGER}),
        json.dumps({"xyz": [1], "sid": session_id, "time": 1.0}),
        json.dumps({"dev": 7, "sid": session_id, "time": 1.0}),
        json.dumps({"jsonrpc": "2.0"}),
        json.dumps({"jsonrpc": "2.0", "id": 424242, "result": {}}),
        json.dumps({"jsonrpc": "2.0", "id": 424242, "error": {"code": -32603}}),
        json.dumps({"jsonrpc": "2.0", "warning": "none"}),
        "[1,2,3]",
        "",
        rng.bytes(64),
    )[rng.integers(15)]
