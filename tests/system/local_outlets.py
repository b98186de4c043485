"""Many outlets of one program, configured as the agent's are.

    python -m tests.system.local_outlets 60

It prints the user's own LSL configuration that it has taken over, then pushes into every
outlet until SIGINT.
"""

from __future__ import annotations

import contextlib
import sys
import time

import pylsl

from biosensor_common.lsl.network import configure_lsl
from biosensor_gateway.settings.models import LslSettings

RATE_HZ = 10.0


def main() -> None:
    print(f"taken over: {configure_lsl(LslSettings().overrides)}", flush=True)
    outlets = [
        pylsl.StreamOutlet(
            pylsl.StreamInfo(f"local-{number}", "Test", 1, RATE_HZ, "float32", f"local-{number}")
        )
        for number in range(int(sys.argv[1]))
    ]
    print(f"open: {len(outlets)}", flush=True)
    with contextlib.suppress(KeyboardInterrupt):
        while True:
            for outlet in outlets:
                outlet.push_sample([1.0])
            time.sleep(1 / RATE_HZ)


if __name__ == "__main__":
    main()
