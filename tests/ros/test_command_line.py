"""What stands on the command line of a node outside of what is ROS's."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from lsl_to_ros.command_line import settle
from lsl_to_ros.parameters.streams import usage
from lsl_to_ros.ros_to_lsl.parameters import usage as usage_of_ros_to_lsl

ROS = ("--ros-args", "-r", "__node:=a", "-p", "Chunk_Length:=5")


@pytest.mark.parametrize("arguments", [(), ROS, (*ROS, "--"), ("--", *ROS)])
def test_what_is_of_ros_passes(arguments: tuple[str, ...]) -> None:
    settle("lsl_to_ros", arguments, usage)


WRONG = [
    (("-p", "Chunk_Length:=5"), "-p must stand behind --ros-args"),
    (("Chunk_Length:=5",), "Chunk_Length:=5 must stand behind --ros-args"),
    (("--topic", *ROS), "there is no argument --topic"),
    ((*ROS, "--", "more"), "there is no argument more"),
]


@pytest.mark.parametrize(("arguments", "words"), WRONG)
def test_what_is_not_known_ends_it(
    capsys: pytest.CaptureFixture[str], arguments: tuple[str, ...], words: str
) -> None:
    with pytest.raises(SystemExit) as caught:
        settle("lsl_to_ros", arguments, usage)
    assert caught.value.code == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"lsl_to_ros: {words}")


@pytest.mark.parametrize("show", [usage, usage_of_ros_to_lsl])
def test_help_is_help(capsys: pytest.CaptureFixture[str], show: Callable[[], str]) -> None:
    with pytest.raises(SystemExit) as caught:
        settle("a_node", ["--help"], show)
    assert not caught.value.code
    text = capsys.readouterr().out
    assert max(map(len, text.splitlines())) <= 80
    assert "session_id" in text
