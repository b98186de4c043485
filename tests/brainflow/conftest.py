"""Boards that BrainFlow itself makes up, read by an unmodified BrainFlow."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from biosensor_gateway.devices.brainflow.driver import DRIVER, BrainFlowSettings
from tests.rigs.driver_run import NotedSink, Run

ENVIRONMENT = Path(__file__).parents[2] / ".venv-peers"


def board_settings(**fields: Any) -> BrainFlowSettings:
    """Settings of the synthetic board, unless the fields say otherwise."""
    if not (ENVIRONMENT / ".installed").exists():
        # A skip would pass where nothing was tried.
        pytest.fail("BrainFlow is not installed: run `make venv-peers` first")
    python = str(ENVIRONMENT / "bin" / "python")
    named = {"sensor": "brainflow", "unit": "1", "board": "SYNTHETIC_BOARD", "python": python}
    return BrainFlowSettings.model_validate(named | fields)


class BoardRun(Run):
    """The supervisor of a board, and what came of it."""

    def __init__(self, **fields: Any) -> None:
        settings = board_settings(**fields)
        assert DRIVER.declare is not None
        sink = NotedSink(settings.sensor_name, spec=DRIVER.declare(settings))
        self._begin(sink, DRIVER.make(settings, sink))
