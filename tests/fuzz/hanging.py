"""A target that hangs with some inputs, as a parser does that does not go on.

Not part of a campaign, as :mod:`.planted`.
"""

from __future__ import annotations

import time

HARMFUL = b"\x02\x20"


def check(data: bytes) -> None:
    """Wait for the rest of a frame, without end."""
    while data.startswith(HARMFUL):
        time.sleep(0.01)
