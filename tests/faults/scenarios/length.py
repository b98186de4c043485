"""How long the scenarios may take."""

from __future__ import annotations

import os

VARIABLE = "BIOSENSOR_GATEWAY_FAULTS"


def is_long() -> bool:
    """Whether the run may take as long as faults take in a lab."""
    return os.environ.get(VARIABLE) == "long"
