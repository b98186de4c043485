"""Checks the DDS variables, that local nodes find each other, and that one lsl_to_ros runs.

The test uses two real nodes in separate processes. The
variables are those of ROS 2 Jazzy; https://docs.ros.org/en/jazzy/Tutorials/Advanced/
Improved-Dynamic-Discovery.html. What ROS does with values that are wrong was measured
with rclpy 7.1 and Fast DDS 2.14.

Run as a program, this module is one of the two processes: the node that is searched for (``stay``),
or the one that searches::

    {"role": "look", "name": "_doctor_5f", "search_s": 5, "settle_s": 2}
    {"found": true, "seconds": 0.4, "middleware": "rmw_fastrtps_cpp", "nodes": ["/lsl_to_ros"]}

A ROS context and its libraries cannot be unloaded from a process, and the middleware may end a
process with an invalid environment.
"""

from __future__ import annotations

import os
import signal
import socket
import sys
import threading
import time
import uuid
from collections import Counter
from collections.abc import Generator, Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from types import FrameType
from typing import Any

from biosensor_common.doctor.check import Context, Finding, error, note, ok, warning
from biosensor_common.doctor.probe import Probe, ProbeError, answer, serve
from lsl_to_ros import ros_environment

DOMAIN, RANGE, PEERS = "ROS_DOMAIN_ID", "ROS_AUTOMATIC_DISCOVERY_RANGE", "ROS_STATIC_PEERS"
SERVER, LOCALHOST_ONLY = "ROS_DISCOVERY_SERVER", "ROS_LOCALHOST_ONLY"
MIDDLEWARE = "RMW_IMPLEMENTATION"
MAX_DOMAIN = 232
_RANGES = ("SUBNET", "LOCALHOST", "OFF", "SYSTEM_DEFAULT")
# TopicPublishers from 32768 on are given away by Linux: https://docs.ros.org/en/jazzy/Concepts/
# Intermediate/About-Domain-ID.html
_SAFE_ON_LINUX = (range(102), range(215, MAX_DOMAIN + 1))
_FAST_DDS = "rmw_fastrtps"
_SHELL = "in this shell and where it is set, for instance ~/.bashrc"
PREFIX = "_biosensor_doctor_"
"""Prefix of the nodes' names; ROS tools do not list names with a leading underscore."""
_POLL_S = 0.05
SEARCH_S = 7.0
# Existing nodes announce themselves every 3 s.
SETTLE_S = 3.5
_LIMIT_S = 14.0
_NODE = "lsl_to_ros"
# Ports of the RTPS standard: base, and ports per domain.
_FIRST_PORT, _PORTS_A_DOMAIN = 7400, 250
_LAUNCH = "ros2 launch lsl_to_ros lsl_to_ros.launch.py"


def dds(_context: Context) -> Iterator[Finding]:
    """Check the environment, then start a node and search for it."""
    if find_spec("rclpy") is None:
        # Without ROS, or before its setup file is sourced; the check versions reports that.
        return
    yield from judge_environment(os.environ)
    name = f"{PREFIX}{uuid.uuid4().hex}"
    command = (sys.executable, "-P", "-m", __name__)
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
        # If nodes do not find each other, an empty graph means nothing.
        yield judge_nodes(graph["nodes"])


def judge_nodes(nodes: Sequence[str]) -> Finding:
    """Check the nodes of the graph, by their full names."""
    ours = Counter(each for each in nodes if each.rpartition("/")[2] == _NODE)
    repeated = {name: count for name, count in ours.items() if count > 1}
    number = domain(os.environ)
    if repeated:
        named = ", ".join(f"{count} nodes have the name {name}" for name, count in repeated.items())
        return error(
            f"{named} (domain {number})",
            "Each publishes every stream: subscribers get every sample more than once, and "
            "parameters are set in only one of them.",
            "end all but one, on whichever computer it runs; nodes for different streams each "
            f"need a namespace: {_LAUNCH} namespace:=NAME",
        )
    if not ours:
        return note(
            f"there is no node {_NODE} (domain {number}, {len(nodes)} other nodes)",
            "Streams reach ROS only while it runs.",
            f"{_LAUNCH}\nif it is running: give both shells the same {DOMAIN}",
        )
    return ok(f"{', '.join(sorted(ours))} is there (domain {number}, {len(nodes)} nodes in total)")


def _found(found: bool, seconds: float | None, middleware: str) -> Finding:
    if found and seconds is not None:
        return ok(f"a node of this computer is found here in {seconds:.1f} s by {middleware}")
    first = _FIRST_PORT + _PORTS_A_DOMAIN * domain(os.environ)
    last = first + _PORTS_A_DOMAIN - 1
    return error(
        f"a node of this computer is not found here within {SEARCH_S:g} s by {middleware}",
        "The topics of the node reach no other program: rviz, rosbag and your nodes see nothing.",
        "fix what this check reports about ROS variables; if nothing, allow it in the firewall: "
        f"sudo ufw allow {first}:{last}/udp, or sudo firewall-cmd --permanent "
        f"--add-port={first}-{last}/udp && sudo firewall-cmd --reload",
    )


def _no_node(problem: ProbeError) -> Finding:
    return error(
        f"a ROS node cannot be started here ({problem})",
        "Neither can the node lsl_to_ros.",
        "source /opt/ros/$ROS_DISTRO/setup.bash and the workspace's install/setup.bash; unset "
        f"{MIDDLEWARE} if its package is not installed; fix what this check reports about ROS "
        "variables",
    )


def judge_environment(environment: Mapping[str, str]) -> Iterator[Finding]:
    """Check every variable."""
    yield _domain(environment.get(DOMAIN, ""))
    only_here = environment.get(LOCALHOST_ONLY, "")
    if only_here:
        yield _localhost_only(only_here)
    if only_here != "1":
        peers = [each for each in environment.get(PEERS, "").split(";") if each]
        yield _range(environment.get(RANGE, ""), peers)
        if peers:
            yield _peers(peers)
    if environment.get(SERVER):
        yield _server(environment[SERVER], environment.get(MIDDLEWARE, ""))


def domain(environment: Mapping[str, str]) -> int:
    """Return the domain that ROS uses; 0 also for an invalid value."""
    text = environment.get(DOMAIN, "")
    return int(text) if text.isdecimal() and int(text) <= MAX_DOMAIN else 0


def _domain(text: str) -> Finding:
    if not text:
        return ok(f"{DOMAIN} is not set: ROS is in domain 0, like all computers without it")
    why = "Nodes see only nodes in their own domain."
    if not text.isdecimal() or int(text) > MAX_DOMAIN:
        return error(
            f"{DOMAIN} is {text!r}, which is not a number from 0 to {MAX_DOMAIN}",
            f"{why} With such a value, most nodes do not even start.",
            f"export {DOMAIN}=0, or the number that the other computers use, {_SHELL}",
        )
    if not any(int(text) in each for each in _SAFE_ON_LINUX):
        return warning(
            f"{DOMAIN} is {text}",
            "Its ports are among those that Linux gives to any program, so nodes sometimes "
            "cannot be reached.",
            f"export {DOMAIN}=N, with N from 0 to 101, on all computers",
        )
    return ok(f"{DOMAIN} is {text}; all computers need the same")


def _localhost_only(text: str) -> Finding:
    if text == "1":
        return warning(
            f"{LOCALHOST_ONLY} is 1",
            f"No other computer sees the topics, and {RANGE} and {PEERS} are ignored. The "
            "variable is deprecated.",
            f"unset {LOCALHOST_ONLY}, {_SHELL}; to hide the topics from other computers: export "
            f"{RANGE}=LOCALHOST",
        )
    return note(
        f"{LOCALHOST_ONLY} is set, to {text!r}",
        f"The variable is deprecated; {RANGE} replaces it.",
        f"unset {LOCALHOST_ONLY}, {_SHELL}",
    )


def _range(text: str, peers: list[str]) -> Finding:
    wide = f"export {RANGE}=SUBNET, {_SHELL}"
    if text and text not in _RANGES:
        return warning(
            f"{RANGE} is {text!r}, which is not one of {', '.join(_RANGES)}",
            "ROS then uses LOCALHOST: no other computer sees the topics.",
            wide,
        )
    if text == "OFF":
        return error(
            f"{RANGE} is OFF",
            "No node finds any other, not even on this computer: the topics reach nobody.",
            wide,
        )
    if text == "LOCALHOST" and not peers:
        return note(
            f"{RANGE} is LOCALHOST",
            "No other computer sees the topics.",
            f"if other computers take part: {wide}, or export {PEERS}='ADDRESS;ADDRESS' with "
            "theirs",
        )
    return ok(f"{RANGE} is {text or 'not set: nodes find each other in the whole subnet'}")


def _peers(peers: list[str]) -> Finding:
    for peer in peers:
        try:
            socket.getaddrinfo(peer, None)
        except (OSError, UnicodeError):
            comma = " Separate peers with ';'." if "," in peer else ""
            return error(
                f"{PEERS} names {peer!r}, which has no address",
                f"With it, nodes do not even start.{comma}",
                f"export {PEERS}='ADDRESS;ADDRESS' with IP addresses, {_SHELL}",
            )
    return ok(f"{PEERS}: {', '.join(peers)}")


def _server(text: str, middleware: str) -> Finding:
    unset = f"unset {SERVER}, {_SHELL}"
    if middleware and not middleware.startswith(_FAST_DDS):
        return warning(
            f"{SERVER} is set, but {MIDDLEWARE} is {middleware}",
            "Only Fast DDS has discovery servers: nodes find each other in a different way than "
            "you expect.",
            f"{unset}; or export {MIDDLEWARE}=rmw_fastrtps_cpp",
        )
    return note(
        f"{SERVER} is {text}",
        "Nodes find each other only while that server runs, and only those that use it.",
        f"if there is none: {unset}; otherwise on all computers export {SERVER}={text!r}, and "
        "for ros2 topic, node and doctor also: export ROS_SUPER_CLIENT=TRUE",
    )


def main() -> None:
    """Run the request from stdin."""
    signal.signal(signal.SIGTERM, _leave)
    serve({"stay": _stay, "look": _look})


def _leave(_number: int, _frame: FrameType | None) -> None:
    # Exits through the context managers, so that the node announces its end.
    sys.exit(0)


def _stay(name: str) -> None:
    """Run a node until this process is ended."""
    with _node(name):
        answer({"open": True})
        threading.Event().wait()


def _look(name: str, search_s: float, settle_s: float) -> None:
    """Search for a node, and list all others until no new one has appeared for a while."""
    with _node(f"{PREFIX}{uuid.uuid4().hex}") as node:
        begun = time.monotonic()
        nodes, found_s, passed_s, changed_s = list[str](), None, 0.0, 0.0
        while passed_s < search_s if found_s is None else passed_s < changed_s + settle_s:
            time.sleep(_POLL_S)
            passed_s = time.monotonic() - begun
            before, nodes = nodes, sorted(_names(node))
            if nodes != before:
                changed_s = passed_s
            if found_s is None and f"/{name}" in nodes:
                found_s = passed_s
            if passed_s > search_s + settle_s:
                break
        answer(
            {
                "found": found_s is not None,
                "seconds": found_s,
                "middleware": _middleware(),
                "nodes": [each for each in nodes if not each.startswith(f"/{PREFIX}")],
            }
        )


@contextmanager
def _node(name: str) -> Generator[Any]:
    import rclpy
    from rclpy.signals import SignalHandlerOptions

    # Starts like the node itself, so that the result is valid for it.
    middleware = _middleware()
    ros_environment.configure_fast_dds(
        os.environ, Path.cwd(), middleware, ros_environment.fast_dds_generation()
    )
    ros_environment.ensure_log_folder(os.environ)
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    try:
        node = rclpy.create_node(name)
        try:
            yield node
        finally:
            node.destroy_node()
    finally:
        # Other nodes list a node that vanishes without notice for many seconds.
        rclpy.try_shutdown()


def _middleware() -> str:
    from rclpy.utilities import get_rmw_implementation_identifier

    return get_rmw_implementation_identifier()


def _names(node: Any) -> Iterator[str]:  # noqa: ANN401 - rclpy's own annotations are partial
    for name, namespace in node.get_node_names_and_namespaces():
        yield f"{namespace.rstrip('/')}/{name}"


if __name__ == "__main__":
    main()
