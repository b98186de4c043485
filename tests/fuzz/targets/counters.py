"""The agent's counters, which the node takes from the network and a recording holds.

They are finite numbers, or refused: by the node with a ValueError, by the reader of
recordings without one.
"""

from __future__ import annotations

import math

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.serialization import deserialize_message, serialize_message

from biosensor_common.ros.messages import CLOCK_FACTS, counters_message, read_counters
from tests.fuzz.contract import ensure

# At its first use it imports what warns.
serialize_message(DiagnosticArray())

_CLOCK = {f"clock_{fact}" for fact in CLOCK_FACTS}


def check(data: bytes) -> None:
    """Read one sample, and make its message."""
    text = data.decode("utf-8", "replace")
    try:
        counters = read_counters(text)
    except ValueError:
        return
    for entry in counters.values():
        ensure(all(map(math.isfinite, entry.values())), "no counter", entry)
        ensure(entry.keys() - _CLOCK == {"pushed", "lost", "last_stamp"}, "other counters", entry)
    message = deserialize_message(counters_message(0, text), DiagnosticArray)
    ensure(len(message.status) == len(counters), "not all are told", counters)
