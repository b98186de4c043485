"""How many functions an ECG frame passes from bleak's callback to liblsl, and the drawing of it."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from types import FrameType

import pytest

from biosensor_gateway.devices.polar_h10.driver.protocol.control_point import Measurement
from tests.polar_h10.conftest import Make
from tests.rigs.bluetooth import ON_BUMBLE
from tests.rigs.driver_run import streaming
from tests.rigs.polling import until

ARCHITECTURE = Path(__file__).parents[2] / "docs" / "architecture.md"
OURS = re.compile(r"biosensor_(?:common|gateway)/(?!.*simulat)(.*\.py)$")
MOST_FUNCTIONS = 50
FRAMES = 10
"""The shortest way of them counts: for some the line of the device's clock is fitted again."""


class Way:
    """Notes our functions from the arrival of a frame of ECG to the push of its samples."""

    def __init__(self) -> None:
        self.functions: list[tuple[str, str]] = []
        self.is_over = False
        self._has_begun = False

    def __call__(self, frame: FrameType, event: str, _: object) -> None:
        code = frame.f_code
        if event != "call" or self.is_over:
            return
        if code.co_name == "_arrived":
            self._has_begun = self._has_begun or frame.f_locals["data"][0] == Measurement.ECG
        self.is_over = self._has_begun and code.co_name == "push_chunk"
        module = OURS.search(Path(code.co_filename).as_posix())
        if self._has_begun and module and not code.co_name.startswith("<"):
            self.functions.append((module[1], code.co_qualname))


def drawn_modules() -> set[str]:
    drawing = ARCHITECTURE.read_text(encoding="utf-8").split("```")[1]
    return set(re.findall(r"[\w/]+\.py", drawing))


@pytest.mark.seam
@ON_BUMBLE
async def test_the_way_is_short_and_is_the_one_that_is_drawn(sensor: Make) -> None:
    ways = [Way() for _ in range(FRAMES)]
    async with streaming(sensor()) as run:
        await until(run.sink.has(400, "ecg"))
        for way in ways:
            sys.setprofile(way)
            try:
                await until(lambda way=way: way.is_over)
            finally:
                sys.setprofile(None)
    functions = min((set(way.functions) for way in ways), key=len)
    assert len(functions) <= MOST_FUNCTIONS
    modules = {module.removeprefix("devices/polar_h10/") for module, _ in functions}
    assert modules == drawn_modules()
