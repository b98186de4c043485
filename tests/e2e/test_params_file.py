"""The example of a parameter file, as the real node reads it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from rcl_interfaces.srv import GetParameters

PARAMS_FILE = Path(__file__).parents[2] / "ros_side" / "lsl_to_ros" / "config" / "params.yaml"
TYPE_BOOL, TYPE_INTEGER, TYPE_STRING = 1, 2, 4
EXPECTED = {
    "topic_prefix": "biosensors",
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


def _plain(value: Any) -> bool | int | str | None:
    fields = {TYPE_BOOL: "bool_value", TYPE_INTEGER: "integer_value", TYPE_STRING: "string_value"}
    return getattr(value, fields[value.type]) if value.type in fields else None


@pytest.mark.parametrize("namespace", ["/", "/lab"])
def test_the_node_takes_every_value_of_the_example(
    programs: Any, listener: Any, wait_until: Callable[..., None], namespace: str
) -> None:
    options = ("--params-file", str(PARAMS_FILE), "--remap", f"__ns:={namespace}")
    node = programs.start("lsl_to_ros.node", "--ros-args", *options)
    service = f"{namespace.rstrip('/')}/lsl_to_ros/get_parameters"
    client = listener.node.create_client(GetParameters, service)
    assert client.wait_for_service(timeout_sec=30.0), programs.log(node)
    future = client.call_async(GetParameters.Request(names=list(EXPECTED)))
    wait_until(future.done, "the node's parameters")
    values = [_plain(value) for value in future.result().values]
    assert dict(zip(EXPECTED, values, strict=True)) == EXPECTED
    # It says so of a key that it does not know.
    assert "ERROR" not in programs.log(node)
