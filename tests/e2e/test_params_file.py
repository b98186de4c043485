"""The example of a parameter file, as the real node reads it."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from rcl_interfaces.srv import GetParameters

from tests.rigs.polling import wait_until

pytestmark = pytest.mark.nightly

# The fields of a ParameterValue by its type's number.
FIELDS = {
    1: "bool_value",
    2: "integer_value",
    3: "double_value",
    4: "string_value",
    9: "string_array_value",
}
PARAMS_FILE = Path(__file__).parents[2] / "ros_side" / "lsl_to_ros" / "config" / "params.yaml"
IN_USE: dict[str, Any] = {
    "topic_prefix": "biosensors",
    "burst_pacing": 0.5,
    "Sensor_Enable": True,
    "Chunk_Enable": True,
    "Chunk_Length": 128,
    "empatica_e4.Chunk_Length": 64,
    "empatica_e4.gsr.Chunk_Length": 4,
    "empatica_e4.acc.Sensor_Enable": False,
    "polar_h10.Chunk_Enable": False,
    "zephyr.br.Chunk_Length": 18,
    "zephyr.ecg.Chunk_Length": 250,
}
COMMENTED_OUT: dict[str, Any] = {
    "stream_predicate": "starts-with(name, 'p01-')",
    "empatica_e4_left.Chunk_Enable": False,
    "empatica_e4_left.bvp.Chunk_Length": 32,
    "p01.polar_h10.Sensor_Enable": False,
    "p01.empatica_e4_left.gsr.Chunk_Length": 8,
    "qos_overrides./biosensors/zephyr/ecg.publisher.history": "keep_last",
    "qos_overrides./biosensors/zephyr/ecg.publisher.depth": 50,
    "qos_overrides./biosensors/zephyr/ecg.publisher.reliability": "best_effort",
    "qos_overrides./biosensors/zephyr/ecg.publisher.durability": "volatile",
    "diagnostic_updater.period": 5.0,
    "aliases": ["Muse (00:55:DA)=muse_left", "Muse (*=muse_right"],
    "compat": "",
    "session_id": "lab-2",
    "known_peers": ["127.0.0.1"],
}
_EXAMPLE = re.compile(r"^( +)#(?=\S|  )", re.MULTILINE)
_PEERS = "192.168.1.20, lab-pc.local"

ReadParameters = Callable[..., dict[str, Any]]


def _plain(value: Any) -> Any:
    return getattr(value, FIELDS[value.type]) if value.type in FIELDS else None


@pytest.fixture
def read_parameters(programs: Any, listener: Any) -> ReadParameters:
    """Start the node with these options; ask it for parameters by its full name."""

    def read(names: list[str], *options: str, node_name: str = "/lsl_to_ros") -> dict[str, Any]:
        node = programs.start("lsl_to_ros.node", "--ros-args", *options)
        client = listener.node.create_client(GetParameters, f"{node_name}/get_parameters")
        assert client.wait_for_service(timeout_sec=30.0), programs.log(node)
        future = client.call_async(GetParameters.Request(names=names))
        wait_until(future.done, "the node's parameters")
        # It says so of a key that it does not know, and of a value that it does not take.
        assert "ERROR" not in programs.log(node)
        values = [_plain(value) for value in future.result().values]
        return dict(zip(names, values, strict=True))

    return read


@pytest.mark.seam
@pytest.mark.parametrize("namespace", ["/", "/lab"])
def test_the_node_takes_every_value_of_the_example(
    read_parameters: ReadParameters, namespace: str
) -> None:
    options = ("--params-file", str(PARAMS_FILE), "--remap", f"__ns:={namespace}")
    name = f"{namespace.rstrip('/')}/lsl_to_ros"
    assert read_parameters(list(IN_USE), *options, node_name=name) == IN_USE


def test_the_node_takes_every_example_that_is_commented_out(
    read_parameters: ReadParameters, tmp_path: Path
) -> None:
    text = _EXAMPLE.sub(r"\1", PARAMS_FILE.read_text())
    assert _PEERS in text
    # No test asks other hosts for streams.
    path = tmp_path / "params.yaml"
    path.write_text(text.replace(_PEERS, "127.0.0.1"))
    expected = IN_USE | COMMENTED_OUT
    assert read_parameters(list(expected), "--params-file", str(path)) == expected


@pytest.mark.parametrize("key", ["/**", "/lab/lsl_left"], ids=["wildcard", "full name"])
def test_what_the_launch_file_is_given_overrules_the_example(
    read_parameters: ReadParameters, tmp_path: Path, key: str
) -> None:
    # launch_ros hands arguments on as a second file; its key is the node's full name, or
    # the wildcard where it does not know the namespace.
    given = tmp_path / "launch_params"
    given.write_text(f"{key}:\n  ros__parameters:\n    topic_prefix: left\n")
    options = ("--params-file", str(PARAMS_FILE), "--params-file", str(given))
    renamed = ("--remap", "__node:=lsl_left", "--remap", "__ns:=/lab")
    values = read_parameters(list(IN_USE), *options, *renamed, node_name="/lab/lsl_left")
    assert values == IN_USE | {"topic_prefix": "left"}
