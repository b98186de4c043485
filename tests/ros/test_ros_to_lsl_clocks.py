"""Robots whose clock is not this computer's, from their messages to the stamps in LSL."""

from __future__ import annotations

import os
import re
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING
from xml.etree import ElementTree

import pylsl
import pytest

from tests.rigs.compiler import compile_c

if TYPE_CHECKING:
    from tests.ros.conftest import Ros, RunningNode

pytestmark = pytest.mark.nightly

SOURCE = Path(__file__).parents[1] / "rigs" / "shifted_clock.c"
ARGUMENTS = ("--ros-args", "-p", "topics:=[/pose, /vel]")
END_S = 30.0
SAMPLES = 40


@pytest.fixture
def start_robot(tmp_path: Path) -> Iterator[Callable[..., None]]:
    """Start a robot whose time of day is so many milliseconds off."""
    library = tmp_path / "shifted_clock.so"
    compile_c(SOURCE, library, "-shared", "-fPIC")
    robots: list[subprocess.Popen[bytes]] = []

    def start(shift_ms: int, *arguments: str) -> None:
        command = [sys.executable, "-m", "tests.rigs.shifted_publisher", *arguments]
        shifted = {"SHIFT_MS": str(shift_ms), "LD_PRELOAD": str(library)}
        robots.append(subprocess.Popen(command, env=os.environ | shifted))

    yield start
    for robot in robots:
        robot.kill()
        robot.wait(END_S)


def stamps_off_s(ros: Ros, name: str, column: str) -> tuple[float, ElementTree.Element]:
    """Return by how much the stamps of a stream are off the true time, and its header."""
    resolver = pylsl.ContinuousResolver(prop="name", value=name)
    ros.until(lambda: bool(resolver.results()), f"a stream {name}")
    inlet = pylsl.StreamInlet(resolver.results()[0])
    inlet.open_stream(END_S)
    header = ElementTree.fromstring(inlet.info(END_S).as_xml())
    labels = [each.text for each in header.findall("desc/channels/channel/label")]
    place, off = labels.index(column), list[float]()
    # LSL's clock is the monotonic one, from another origin.
    origin_s = pylsl.local_clock() - time.monotonic()

    def take() -> bool:
        samples, stamps = inlet.pull_chunk(timeout=0.0, max_samples=1024)
        both = zip(samples, stamps, strict=True)
        off.extend(stamp - sample[place] - origin_s for sample, stamp in both)
        return len(off) >= SAMPLES

    ros.until(take, f"samples of {name}")
    return statistics.median(off), header


ROBOTS = [
    (-500, (), "wrong", r"(\d\.\d+) s behind this computer's time, as measured"),
    (-500, ("deaf",), "behind", r"behind by up to (\d\.\d+) s"),
    (-40, (), "wrong", r"(\d\.\d+) s behind this computer's time, as measured"),
    (0, (), "synchronised", ""),
]


@pytest.mark.parametrize(("shift_ms", "arguments", "word", "sentence"), ROBOTS)
def test_no_stamp_is_of_a_clock_that_is_behind(
    ros: Ros,
    start_node: Callable[..., RunningNode],
    start_robot: Callable[..., None],
    shift_ms: int,
    arguments: tuple[str, ...],
    word: str,
    sentence: str,
) -> None:
    start_robot(shift_ms, *arguments)
    start_node(*ARGUMENTS, module="lsl_to_ros.ros_to_lsl.node")
    for name, column in (("pose", "pose.position.y"), ("vel", "linear.y")):
        off_s, header = stamps_off_s(ros, name, column)
        assert abs(off_s) < 0.02
        assert abs(float(header.findtext("desc/ros/clock_edge_s", "")) + shift_ms / 1000) < 0.02

        def is_said(topic: str = f"/{name}") -> bool:
            status = ros.status(topic)
            if status is None or word not in status["clock_source"]:
                return False
            found = re.search(sentence, status.message)
            return found is not None and (
                not found.groups() or abs(float(found[1]) + shift_ms / 1000) < 0.02
            )

        ros.until(is_said, f"{word!r} in /diagnostics")
