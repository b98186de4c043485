"""An agent's outlet that sends at known times.

    python -m tests.rigs.hosts.sender

The wristband's skin temperature, whose values are the numbers of the samples. Steered:
``sent`` tells the true time of each, in ns of Unix time.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any, NamedTuple

import pylsl

from biosensor_common.lsl.api_file import LslOverrides
from biosensor_common.lsl.network import configure_lsl
from biosensor_common.spec import DeviceIdentity, DeviceInfo
from biosensor_gateway.devices.registry import declaration
from biosensor_gateway.streaming.outlets import Outlet
from tests.rigs.hosts.programs import Dialogue

SENSOR, DATA = "empatica_e4", "st"
RATE_HZ = 4.0
_TRIES = 10


class Moment(NamedTuple):
    """One moment on two clocks: ns of Unix time, and seconds of this computer's LSL clock."""

    true_ns: int
    lsl_s: float


def now() -> Moment:
    """Read both clocks; of several times that which took least."""
    reads: list[tuple[int, Moment]] = []
    for _ in range(_TRIES):
        before, lsl_s, after = time.time_ns(), pylsl.local_clock(), time.time_ns()
        reads.append((after - before, Moment((before + after) // 2, lsl_s)))
    return min(reads)[1]


class Sender:
    """Pushes a numbered sample at each call of `send`."""

    def __init__(self) -> None:
        configure_lsl(LslOverrides())
        stream = declaration(SENSOR).stream(DATA)
        self._outlet = Outlet(stream, DeviceIdentity(SENSOR, "numbered"), DeviceInfo())
        self._sent: list[int] = []

    def send(self) -> None:
        moment = now()
        refusal = self._outlet.push([[len(self._sent)]], [moment.lsl_s])
        if refusal is not None:
            raise ValueError(refusal)
        self._sent.append(moment.true_ns)

    def obey(self, command: Mapping[str, Any]) -> list[int]:
        if command["do"] != "sent":
            raise ValueError(f"what is {command['do']!r}?")
        return self._sent


def main() -> None:
    sender = Sender()
    dialogue = Dialogue()
    due = time.monotonic()
    while not dialogue.ended:
        sender.send()
        dialogue.answer(sender.obey)
        due += 1.0 / RATE_HZ
        time.sleep(max(0.0, due - time.monotonic()))


if __name__ == "__main__":
    main()
