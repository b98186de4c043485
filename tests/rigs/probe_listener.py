"""A program of its own that is connected to a probe: ``python -m tests.rigs.probe_listener``.

It says ``listening`` once it is notified, or ``connected`` with the argument ``quiet``, and then
stays until it is killed.
"""

from __future__ import annotations

import asyncio
import sys

from biosensor_gateway.transports.ble import BleLink
from tests.rigs.probe import FLOW, choice


async def _listen(quiet: bool) -> None:
    link = BleLink(choice("1"))
    await link.open()
    if quiet:
        print("connected", flush=True)
    else:
        await link.subscribe(FLOW)
        print("listening", flush=True)
    await asyncio.Event().wait()


if __name__ == "__main__":
    asyncio.run(_listen("quiet" in sys.argv[1:]))
