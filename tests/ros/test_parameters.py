"""Which parameter holds for a stream, and which are refused."""

from __future__ import annotations

from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import pytest
from rclpy.node import Node
from rclpy.parameter import Parameter
from std_msgs.msg import String

from biosensor_common.spec import DeviceIdentity
from lsl_to_ros.parameters.streams import Parameters, StreamSettings, prefixes
from lsl_to_ros.topics.publishers import make_publisher

if TYPE_CHECKING:
    from tests.ros.conftest import MakeNode

PLAIN = DeviceIdentity("zephyr", "BH1")
FULL = DeviceIdentity("empatica_e4", "A1", participant="p01", label="left")
DEFAULT = StreamSettings(raw=True, chunk=True, chunk_length=128)


def set_to(node: Node, **values: Any) -> str:
    given = [Parameter(name.replace("__", "."), value=v) for name, v in values.items()]
    return "".join(result.reason for result in node.set_parameters(given))


def test_the_most_specific_prefix_comes_first() -> None:
    assert prefixes(PLAIN, "ecg") == ["zephyr.ecg", "zephyr"]
    assert prefixes(FULL, "bvp") == [
        "p01.empatica_e4_left.bvp",
        "p01.empatica_e4.bvp",
        "empatica_e4_left.bvp",
        "empatica_e4.bvp",
        "p01.empatica_e4_left",
        "p01.empatica_e4",
        "empatica_e4_left",
        "empatica_e4",
    ]


@pytest.mark.nightly
def test_defaults_are_those_of_the_original_framework(make_node: MakeNode) -> None:
    assert Parameters(make_node()).settings(PLAIN, "ecg", "ecg") == DEFAULT


@pytest.mark.seam
def test_each_more_specific_key_wins(make_node: MakeNode) -> None:
    node = make_node()
    parameters = Parameters(node)

    def lengths() -> tuple[int, int, int]:
        wanted = ((FULL, "bvp"), (FULL, "gsr"), (PLAIN, "ecg"))
        left, middle, right = (
            parameters.settings(who, what, what).chunk_length for who, what in wanted
        )
        return left, middle, right

    steps: list[tuple[str, tuple[int, int, int]]] = [
        ("Chunk_Length", (1, 1, 1)),
        ("empatica_e4__Chunk_Length", (2, 2, 1)),
        ("empatica_e4_left__Chunk_Length", (3, 3, 1)),
        ("p01__empatica_e4__Chunk_Length", (4, 4, 1)),
        ("p01__empatica_e4_left__Chunk_Length", (5, 5, 1)),
        ("empatica_e4__bvp__Chunk_Length", (6, 5, 1)),
        ("p01__empatica_e4_left__bvp__Chunk_Length", (7, 5, 1)),
    ]
    for number, (name, expected) in enumerate(steps, 1):
        assert set_to(node, **{name: number}) == ""
        assert lengths() == expected


@pytest.mark.nightly
def test_a_chunk_needs_both_enables(make_node: MakeNode) -> None:
    node = make_node()
    parameters = Parameters(node)
    for sensor_on, chunk_on in ((True, False), (False, True), (False, False)):
        assert set_to(node, Sensor_Enable=sensor_on, Chunk_Enable=chunk_on) == ""
        settings = parameters.settings(PLAIN, "ecg", "ecg")
        assert (settings.raw, settings.chunk) == (sensor_on, False)


@pytest.mark.nightly
def test_a_chunk_with_a_name_of_its_own_has_parameters_of_its_own(make_node: MakeNode) -> None:
    node = make_node()
    parameters = Parameters(node)
    assert set_to(node, zephyr__breathing__Chunk_Length=3, zephyr__br__Chunk_Length=5) == ""
    assert set_to(node, zephyr__br__Sensor_Enable=False) == ""
    breathing = parameters.settings(PLAIN, "breathing", "br")
    assert breathing == StreamSettings(raw=True, chunk=False, chunk_length=5)
    assert not parameters.settings(PLAIN, "br", "").raw


@pytest.mark.nightly
@pytest.mark.parametrize("prefix", ["", "zephyr__", "p01__zephyr__", "zephyr__ecg__"])
@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("Chunk_Length", 0),
        ("Chunk_Length", -1),
        ("Chunk_Length", 100_001),
        ("Chunk_Length", 12.0),
        ("Chunk_Length", True),
        ("Chunk_Length", "12"),
        ("Chunk_Enable", 1),
        ("Sensor_Enable", "yes"),
    ],
)
def test_a_wrong_value_is_refused_with_a_reason_and_changes_nothing(
    make_node: MakeNode, prefix: str, key: str, value: Any
) -> None:
    node = make_node()
    parameters = Parameters(node)
    reason = set_to(node, **{prefix + key: value})
    assert reason
    assert parameters.settings(PLAIN, "ecg", "ecg") == DEFAULT


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("name", "right"),
    [
        ("zephyr__Sensor_Enabled", "zephyr.Sensor_Enable"),
        ("zephyr__ecg__length", "zephyr.ecg.Chunk_Length"),
        ("Sensor_Enabled", "Sensor_Enable"),
        ("chunk_length", "Chunk_Length"),
    ],
)
def test_a_misspelt_name_is_refused(make_node: MakeNode, name: str, right: str) -> None:
    node = make_node()
    Parameters(node)
    reason = set_to(node, **{name: True})
    assert reason.startswith(name.replace("__", "."))
    assert reason.endswith(f"; {right} is")
    assert not node.has_parameter(name.replace("__", "."))


@pytest.mark.nightly
def test_a_parameter_that_was_removed_is_ignored_and_refused_with_what_to_do(
    make_node: MakeNode,
) -> None:
    node = make_node(processes=4, Chunk_Length=7)
    errors: list[str] = []
    logger: Any = node.get_logger()
    told: Any = SimpleNamespace(error=errors.append, info=logger.info)
    node.get_logger = lambda: told
    parameters = Parameters(node)
    (sentence,) = errors
    assert sentence.startswith("processes is no longer a parameter: ")
    assert "stream_predicate" in sentence
    assert sentence.endswith("; it is ignored")
    assert not node.has_parameter("processes")
    assert parameters.settings(PLAIN, "ecg", "ecg").chunk_length == 7
    assert "stream_predicate" in set_to(node, processes=2)
    assert not node.has_parameter("processes")


@pytest.mark.nightly
def test_other_parameters_of_a_node_are_left_alone(make_node: MakeNode) -> None:
    node = make_node(topic_prefix="x", qos_overrides__any__publisher__depth=3)
    Parameters(node)
    assert set_to(node, use_sim_time=False, topic_prefix="y") == ""
    assert node.get_parameter("qos_overrides.any.publisher.depth").value == 3


@pytest.mark.nightly
def test_a_streams_keys_are_listed_without_being_set(make_node: MakeNode) -> None:
    node = make_node(zephyr__ecg__Chunk_Length=9)
    parameters = Parameters(node)
    parameters.declare(PLAIN, "ecg", "ecg")
    for name in ("zephyr.Sensor_Enable", "zephyr.ecg.Chunk_Enable"):
        assert node.has_parameter(name)
        assert node.get_parameter(name).value is None
    assert parameters.settings(PLAIN, "ecg", "ecg").chunk_length == 9
    assert set_to(node, zephyr__ecg__Chunk_Enable=3)
    assert set_to(node, zephyr__ecg__Chunk_Enable=False) == ""
    assert not parameters.settings(PLAIN, "ecg", "ecg").chunk


@pytest.mark.nightly
def test_a_value_that_was_set_can_be_unset_again(make_node: MakeNode) -> None:
    node = make_node(zephyr__Chunk_Length=7)
    parameters = Parameters(node)
    parameters.declare(PLAIN, "ecg", "ecg")
    assert set_to(node, zephyr__ecg__Chunk_Length=9) == ""
    assert parameters.settings(PLAIN, "ecg", "ecg").chunk_length == 9
    assert set_to(node, zephyr__ecg__Chunk_Length=None) == ""
    assert parameters.settings(PLAIN, "ecg", "ecg").chunk_length == 7


@pytest.mark.nightly
def test_of_a_key_that_fits_no_stream_it_is_said(make_node: MakeNode) -> None:
    parameters = Parameters(make_node())
    early = Parameter("zephyr.ecg.Chunk_Length", value=9)
    assert parameters.without_stream([early]) == [
        "zephyr.ecg.Chunk_Length applies to no stream yet (none has arrived so far)"
    ]
    parameters.declare(PLAIN, "ecg", "ecg")
    typo = Parameter("zephy.Chunk_Length", value=9)
    everything = Parameter("Chunk_Length", value=9)
    assert parameters.without_stream([early, typo, everything]) == [
        "zephy.Chunk_Length applies to no stream yet (seen so far: zephyr)"
    ]


@pytest.mark.nightly
def test_what_param_dump_writes_of_keys_that_are_not_set_is_read_as_that(
    make_node: MakeNode,
) -> None:
    node: Any = make_node(zephyr__ecg__Chunk_Length="null", zephyr__Chunk_Length=7)
    said: list[str] = []
    node.get_logger().error = said.append
    parameters = Parameters(node)
    parameters.declare(PLAIN, "ecg", "ecg")
    assert said == []
    assert set_to(node, zephyr__ecg__Chunk_Enable="None", zephyr__ecg__Chunk_Length="null") == ""
    assert node.get_parameter("zephyr.ecg.Chunk_Length").value is None
    assert parameters.settings(PLAIN, "ecg", "ecg").chunk_length == 7


@pytest.mark.nightly
def test_of_quality_of_service_only_what_is_set_is_listed(make_node: MakeNode) -> None:
    given = "qos_overrides./overridden.publisher.depth"
    node = make_node(**{given: 7})
    opened = [make_publisher(node, topic, String) for topic in ("usual", "overridden")]
    assert list(node.get_parameters_by_prefix("qos_overrides")) == ["/overridden.publisher.depth"]
    assert [publisher.qos_profile.depth for publisher in opened] == [300, 7]


@pytest.mark.seam
def test_no_value_of_several_is_taken_if_one_is_refused(make_node: MakeNode) -> None:
    node: Any = make_node()
    parameters = Parameters(node)
    result = node.set_parameters_atomically(
        [Parameter("Chunk_Length", value=5), Parameter("zephyr.Chunk_Length", value=0)]
    )
    assert "zephyr.Chunk_Length" in result.reason
    assert parameters.settings(PLAIN, "ecg", "ecg") == DEFAULT


@pytest.mark.nightly
def test_a_listener_hears_of_every_change_and_of_no_other(make_node: MakeNode) -> None:
    node = make_node()
    parameters = Parameters(node)
    calls: list[int] = []
    parameters.on_change(lambda: calls.append(1))
    set_to(node, Chunk_Length=5)
    assert len(calls) == 1
    set_to(node, Chunk_Length=0)
    assert len(calls) == 1
    # To declare is to set, as ROS sees it.
    parameters.declare(PLAIN, "ecg", "ecg")
    node.declare_parameter("qos_overrides./x.publisher.depth", 5)
    assert len(calls) == 1
    set_to(node, zephyr__ecg__Chunk_Length=6)
    assert len(calls) == 2
