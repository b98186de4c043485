"""Virtual devices beside a Windows PC, which reaches them over TCP, TLS and serial ports.

    python -m tests.rigs.windows.devices empatica_e4 zephyr ...

Steered: ``describe`` tells their settings by sensor and the environment that an agent
needs, with paths and ports as this computer has them; ``clocks`` tells this computer's
clocks; everything else is a command of :mod:`tests.rigs.lab`.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping
from contextlib import ExitStack
from typing import Any

from tests.rigs.hosts.programs import Dialogue
from tests.rigs.lab import Lab
from tests.rigs.processes import before_others
from tests.rigs.windows.clocks import read_clocks

PERIOD_S = 0.02


def main() -> None:
    before_others()
    with ExitStack() as stack:
        # Each has its own signals, so that no stream can be taken for another's.
        devices = [
            {"key": name, "sensor": name, "options": {"seed": number}}
            for number, name in enumerate(sys.argv[1:], start=1)
        ]
        lab = Lab(devices, stack)

        def obey(command: Mapping[str, Any]) -> Any:
            match command["do"]:
                case "describe":
                    return lab.describe()
                case "clocks":
                    return read_clocks()._asdict()
                case _:
                    return lab.obey(dict(command))

        dialogue = Dialogue()
        while not dialogue.ended:
            dialogue.answer(obey)
            time.sleep(PERIOD_S)


if __name__ == "__main__":
    main()
