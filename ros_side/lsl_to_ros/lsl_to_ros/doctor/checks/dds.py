"""Checks that ROS nodes of this computer find each other, and that one lsl_to_ros runs.

Both nodes of the test are real ones in processes of their own, as any two nodes are.
"""

from __future__ import annotations

import os
import sys
import uuid
from collections import Counter
from collections.abc import Iterator, Sequence
from importlib.util import find_spec

from biosensor_common.doctor.children import Probe, ProbeError
from biosensor_common.doctor.context import Context
from biosensor_common.doctor.finding import Finding, error, note, ok
from lsl_to_ros.doctor import dds_environment

SEARCH_S = 7.0
# Nodes that are there already announce themselves every 3 s.
SETTLE_S = 3.5
_LIMIT_S = 14.0
_NODE = "lsl_to_ros"
# Of the RTPS standard: base, and ports of a domain.
_FIRST_PORT, _PORTS_A_DOMAIN = 7400, 250
_LAUNCH = "ros2 launch lsl_to_ros lsl_to_ros.launch.py"


def examine(_context: Context) -> Iterator[Finding]:
    """Look at the environment, then start a node and look for it."""
    if find_spec("rclpy") is None:
        # Not a computer of ROS, or its setup file was not sourced: versions says so.
        return
    yield from dds_environment.judge(os.environ)
    name = f"_biosensor_doctor_{uuid.uuid4().hex}"
    command = (sys.executable, "-P", "-m", "lsl_to_ros.doctor.graph_probe")
    with (
        Probe("stay", _LIMIT_S, command=command, name=name) as node,
        Probe(
            "look", _LIMIT_S, command=command, name=name, search_s=SEARCH_S, settle_s=SETTLE_S
        ) as looking,
    ):
        try:
            node.answer()
            graph = looking.answer()
        except ProbeError as problem:
            yield _no_node(problem)
            return
    yield _found(graph["found"], graph["seconds"], graph["middleware"])
    if graph["found"]:
        # Else an empty graph says nothing.
        yield judge_nodes(graph["nodes"])


def judge_nodes(nodes: Sequence[str]) -> Finding:
    """Judge the nodes of the graph, by their full names."""
    ours = Counter(each for each in nodes if each.rpartition("/")[2] == _NODE)
    repeated = {name: count for name, count in ours.items() if count > 1}
    number = dds_environment.domain(os.environ)
    if repeated:
        named = ", ".join(f"{count} nodes are called {name}" for name, count in repeated.items())
        return error(
            f"{named} (domain {number})",
            "Each publishes every stream: subscribers get every sample more than once, and "
            "parameters are set in one of them only.",
            "end all but one, on whichever computer it runs; nodes for different streams need a "
            f"namespace each: {_LAUNCH} namespace:=NAME",
        )
    if not ours:
        return note(
            f"no node called {_NODE} is there (domain {number}, {len(nodes)} other nodes)",
            "Streams reach ROS only while it runs.",
            f"{_LAUNCH}\nif it runs: give both shells the same {dds_environment.DOMAIN}",
        )
    return ok(f"{', '.join(sorted(ours))} is there (domain {number}, {len(nodes)} nodes in all)")


def _found(found: bool, seconds: float | None, middleware: str) -> Finding:
    if found and seconds is not None:
        return ok(f"a node of this computer is found here in {seconds:.1f} s by {middleware}")
    first = _FIRST_PORT + _PORTS_A_DOMAIN * dds_environment.domain(os.environ)
    last = first + _PORTS_A_DOMAIN - 1
    return error(
        f"a node of this computer is not found here within {SEARCH_S:g} s by {middleware}",
        "The topics of the node reach no other program: rviz, rosbag and your nodes see nothing.",
        "mend what this check says of the variables of ROS; if nothing, let it through the "
        f"firewall: sudo ufw allow {first}:{last}/udp, or sudo firewall-cmd --permanent "
        f"--add-port={first}-{last}/udp && sudo firewall-cmd --reload",
    )


def _no_node(problem: ProbeError) -> Finding:
    return error(
        f"a ROS node cannot be started here ({problem})",
        "Neither can the node lsl_to_ros.",
        "source /opt/ros/$ROS_DISTRO/setup.bash and the workspace's install/setup.bash; unset "
        f"{dds_environment.MIDDLEWARE} if its package is not installed; mend what this check says "
        "of the variables of ROS",
    )
