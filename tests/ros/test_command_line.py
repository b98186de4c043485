"""Settings of the node on its command line, and one sentence for each that is refused."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rclpy.parameter import Parameter
from rclpy.validate_full_topic_name import validate_full_topic_name
from std_msgs.msg import Float32

from biosensor_common.errors import ConfigError
from lsl_to_ros.command_line import settle
from lsl_to_ros.parameters import node as node_parameters
from lsl_to_ros.parameters.node import (
    BURST_PACING,
    KNOWN_PEERS,
    MAX_DEPTH,
    MAX_PREFIX_CHARACTERS,
    SESSION_ID,
    STREAM_PREDICATE,
    TOPIC_PREFIX,
)
from lsl_to_ros.parameters.streams import check, usage
from lsl_to_ros.ros_to_lsl.parameters import usage as usage_of_ros_to_lsl
from lsl_to_ros.topics.publishers import make_publisher

if TYPE_CHECKING:
    from tests.ros.conftest import MakeNode

# What stands on the command line of a node outside of what is ROS's.

ROS = ("--ros-args", "-r", "__node:=a", "-p", "Chunk_Length:=5")


@pytest.mark.parametrize("arguments", [(), ROS, (*ROS, "--"), ("--", *ROS)])
def test_what_is_of_ros_passes(arguments: tuple[str, ...]) -> None:
    settle("lsl_to_ros", arguments, usage)


WRONG = [
    (("-p", "Chunk_Length:=5"), "-p must come after --ros-args"),
    (("Chunk_Length:=5",), "Chunk_Length:=5 must come after --ros-args"),
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


# Every refused value of the node as a whole gets one sentence that names the parameter.
NAMES = (TOPIC_PREFIX, STREAM_PREDICATE, BURST_PACING, SESSION_ID, KNOWN_PEERS)
QOS = "qos_overrides./lab/biosensors/zephyr/ecg.publisher."
GOOD: list[tuple[str, Any]] = [
    (TOPIC_PREFIX, "biosensors"),
    (TOPIC_PREFIX, ""),
    (TOPIC_PREFIX, "Lab_2/people/p01"),
    (TOPIC_PREFIX, "a" * MAX_PREFIX_CHARACTERS),
    (STREAM_PREDICATE, ""),
    (STREAM_PREDICATE, "type='EEG' or starts-with(name,'p01')"),
    (BURST_PACING, 0.0),
    (BURST_PACING, 1000.0),
    (BURST_PACING, 2),
    (SESSION_ID, ""),
    (SESSION_ID, "lab 3"),
    (KNOWN_PEERS, []),
    (KNOWN_PEERS, [""]),
    (KNOWN_PEERS, ["10.0.0.7", "robot.local"]),
    (QOS + "depth", 1),
    (QOS + "depth", MAX_DEPTH),
    (QOS + "history", "keep_last"),
    (QOS + "history", "keep_all"),
    (QOS + "history", "system_default"),
    (QOS + "reliability", "reliable"),
    (QOS + "reliability", "best_effort"),
    (QOS + "reliability", "system_default"),
    (QOS + "durability", "volatile"),
    (QOS + "durability", "transient_local"),
    (QOS + "durability", "system_default"),
    ("qos_overrides./lab/other.subscription.depth", "not ours"),
]
BAD: list[tuple[str, Any]] = [
    *[
        (TOPIC_PREFIX, value)
        for value in (
            "/absolute",
            "~/private",
            "ends/",
            "a//b",
            "9lives",
            "a/9",
            "a__b",
            "_a",
            "a_",
            "with blank",
            "dash-ed",
            "äöü",
            "a.b",
            "a\n",
            "a" * (MAX_PREFIX_CHARACTERS + 1),
            7,
            True,
            ["biosensors"],
        )
    ],
    *[(STREAM_PREDICATE, value) for value in ("type=", "'", "foo(", "a\0b", 7, ["type='EEG'"])],
    *[(SESSION_ID, value) for value in (42, True, 1.5, ["a"])],
    *[(KNOWN_PEERS, value) for value in ("robot.local", 3, True, 1.5, [1, 2], ["a", 2], b"ab")],
    *[(BURST_PACING, value) for value in (-0.1, 1000.1, math.nan, math.inf, True, "1", [0.5])],
    *[(QOS + "depth", value) for value in (0, -1, True, 10.0, "10", [10], MAX_DEPTH + 1, 2**40)],
    *[(QOS + "history", value) for value in ("keep", "", 1, ["keep_last"], "reliable")],
    *[(QOS + "reliability", value) for value in ("RELIABLE", "keep_all", False)],
    *[(QOS + "durability", value) for value in ("latched", None, 2)],
    *[(QOS + policy, 1) for policy in ("deadline", "lifespan", "Depth", "")],
]


@pytest.mark.parametrize(("name", "value"), GOOD)
def test_good_values_pass(name: str, value: Any) -> None:
    assert node_parameters.is_known(name)
    assert node_parameters.fault(name, value) is None


@pytest.mark.parametrize(("name", "value"), BAD, ids=lambda part: repr(part)[:40])
def test_a_refusal_is_one_sentence_that_names_the_parameter(name: str, value: Any) -> None:
    assert node_parameters.is_known(name)
    check_sentence(name, node_parameters.fault(name, value))


def check_sentence(name: str, sentence: str | None) -> None:
    assert sentence is not None
    assert sentence.startswith(name)
    assert "\n" not in sentence
    assert len(sentence) > len(name) + 10


values = st.recursive(
    st.booleans() | st.integers() | st.floats() | st.text() | st.binary(),
    lambda items: st.lists(items, max_size=3),
    max_leaves=3,
)


@settings(deadline=None)
@given(name=st.sampled_from([*NAMES, *(QOS + p for p in ("depth", "history"))]), value=values)
def test_no_value_raises(name: str, value: Any) -> None:
    sentence = node_parameters.fault(name, value)
    if sentence is not None:
        check_sentence(name, sentence)


@settings(deadline=None)
@given(prefix=st.text("ab9_/", max_size=12))
def test_ros_itself_accepts_what_passes_as_a_prefix(prefix: str) -> None:
    if node_parameters.fault(TOPIC_PREFIX, prefix) is None:
        validate_full_topic_name(f"/{prefix}/data" if prefix else "/data")


WRONG_AT_START: list[tuple[str, object]] = [
    (STREAM_PREDICATE, "type="),
    (SESSION_ID, 42),
    (KNOWN_PEERS, "robot.local"),
    (TOPIC_PREFIX, "/absolute"),
    (QOS + "depth", 0),
    ("use_sim_time", 5),
    ("Chunk_Length", -4),
    ("Chunk_Length", math.nan),
    ("Chunk_Length", [1, 2]),
    ("zephyr.ecg.Chunk_Length", 0),
    ("Sensor_Enable", 1),
    ("stream_predikate", "type='EEG'"),
    ("sesion_id", "lab"),
    ("known_peer", ["a"]),
    ("Chunk_Lenght", 5),
    ("zephyr.ecg.Chunk_length", 5),
    ("robot_name", "tiago"),
]


@pytest.mark.parametrize(("name", "value"), WRONG_AT_START, ids=str)
def test_what_is_wrong_at_the_start_ends_the_node(name: str, value: object) -> None:
    with pytest.raises(ConfigError) as caught:
        check({name: value})
    check_sentence(name, str(caught.value))


def test_a_misspelt_name_is_answered_by_the_right_one() -> None:
    with pytest.raises(ConfigError, match=r"; zephyr\.ecg\.Chunk_Length is$"):
        check({"zephyr.ecg.Chunk_Lenght": 5})


def test_what_is_right_or_of_ros_does_not_end_it() -> None:
    check(dict(GOOD))
    check({"p01.zephyr.ecg.Chunk_Length": 5, "Sensor_Enable": False, "use_sim_time": True})
    check({"start_type_description_service": True, "diagnostic_updater.use_fqn": True})


def test_names_of_others_are_not_known() -> None:
    for name in ("Chunk_Length", "topic_prefixes", "qos_override.x"):
        assert not node_parameters.is_known(name)


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("name", "default"),
    [(TOPIC_PREFIX, "biosensors"), (STREAM_PREDICATE, ""), (SESSION_ID, ""), (KNOWN_PEERS, [""])],
)
def test_defaults(make_node: MakeNode, name: str, default: Any) -> None:
    node = make_node()
    assert list(node_parameters.declare(node, name)) == list(default)
    assert node.has_parameter(name)


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("name", "value"),
    [
        (TOPIC_PREFIX, "lab"),
        (STREAM_PREDICATE, "type='EEG'"),
        (SESSION_ID, "lab3"),
        (KNOWN_PEERS, ["a", "b"]),
    ],
)
def test_what_a_file_says_holds(make_node: MakeNode, name: str, value: Any) -> None:
    assert node_parameters.declare(make_node(**{name: value}), name) == value


@pytest.mark.nightly
@pytest.mark.parametrize(("name", "value"), [(TOPIC_PREFIX, 3), (STREAM_PREDICATE, True)])
def test_the_type_cannot_be_changed_while_the_node_runs(
    make_node: MakeNode, name: str, value: Any
) -> None:
    node = make_node()
    node_parameters.declare(node, name)
    (result,) = node.set_parameters([Parameter(name, value=value)])
    assert not result.successful
    assert "type" in result.reason


@pytest.mark.nightly
@pytest.mark.parametrize(("name", "value"), [(SESSION_ID, "x"), (KNOWN_PEERS, ["x"])])
def test_what_lsl_reads_once_is_read_only(make_node: MakeNode, name: str, value: Any) -> None:
    node = make_node()
    node_parameters.declare(node, name)
    (result,) = node.set_parameters([Parameter(name, value=value)])
    assert not result.successful


@pytest.mark.nightly
@pytest.mark.parametrize(("name", "value"), [(n, v) for n, v in GOOD if n.startswith(QOS)])
def test_rclpy_opens_a_topic_with_every_override_that_passes(
    make_node: MakeNode, name: str, value: Any
) -> None:
    node = make_node(**{name: value})
    publisher = make_publisher(node, "/lab/biosensors/zephyr/ecg", Float32)
    assert node.get_parameter(name).value == value
    node.destroy_publisher(publisher)
