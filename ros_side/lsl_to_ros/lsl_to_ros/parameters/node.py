"""The parameters of the node as a whole."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Any, TypeGuard, cast

from rcl_interfaces.msg import (
    FloatingPointRange,
    ParameterDescriptor,
    ParameterType,
)
from rclpy.node import Node

from biosensor_common.lsl.network import is_query

TOPIC_PREFIX, STREAM_PREDICATE = "topic_prefix", "stream_predicate"
SESSION_ID, KNOWN_PEERS = "session_id", "known_peers"
BURST_PACING = "burst_pacing"
ALIASES = "aliases"
COMPAT, SMARTLAB = "compat", "smartlab"
DIAGNOSTICS_PERIOD = "diagnostic_updater.period"
"""Named as in ``diagnostic_updater``, so that one file can set it for all nodes."""

QOS_OVERRIDES, USE_SIM_TIME = "qos_overrides.", "use_sim_time"
MAX_PREFIX_CHARACTERS = 100
MAX_DEPTH = 1_000_000
# Measured: docs/decisions/node/pace-bursts-for-subscribers.md.
PACING_PER_MS, MAX_PACING_PER_MS = 0.5, 1000.0
# Rates and delays are measured over a second.
PERIOD_S, MAX_PERIOD_S = 1.0, 3600.0
PERIOD_TEXT = "seconds between two reports on /diagnostics, unless a level changes"

_ALIAS = re.compile(r"[A-Za-z][A-Za-z0-9]*(_[A-Za-z0-9]+)*")
_RELATIVE_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*(/[A-Za-z][A-Za-z0-9_]*)*")
_QOS_VALUES = {
    "history": ("keep_last", "keep_all", "system_default"),
    "reliability": ("reliable", "best_effort", "system_default"),
    "durability": ("volatile", "transient_local", "system_default"),
}


@dataclass(frozen=True, slots=True)
class _Parameter:
    """One parameter; ``fault`` says why a value of the right type is refused."""

    default: str | float | list[str]
    description: str
    fault: Callable[[Any], str | None]
    read_only: bool = False
    least: float = 0.0
    most: float | None = None

    @property
    def descriptor(self) -> ParameterDescriptor:
        limits = (
            []
            if self.most is None
            else [FloatingPointRange(from_value=self.least, to_value=self.most)]
        )
        return ParameterDescriptor(
            description=self.description,
            read_only=self.read_only,
            type=_TYPES[type(self.default)],
            floating_point_range=limits,
        )


_TYPES: dict[type[Any], int] = {
    float: ParameterType.PARAMETER_DOUBLE,
    list: ParameterType.PARAMETER_STRING_ARRAY,
    str: ParameterType.PARAMETER_STRING,
}


def _prefix_fault(value: str) -> str | None:
    is_name = _RELATIVE_NAME.fullmatch(value) and "__" not in value and not value.endswith("_")
    if (is_name and len(value) <= MAX_PREFIX_CHARACTERS) or not value:
        return None
    return (
        "must be a relative ROS name of letters, digits, single underscores and slashes,"
        f" at most {MAX_PREFIX_CHARACTERS} characters, such as biosensors; it is {value!r}"
    )


def _query_fault(value: str) -> str | None:
    if not value or is_query(value):
        return None
    return f"must be an LSL query such as type='EEG' or starts-with(name,'p01'), not {value!r}"


def _pacing_fault(value: float) -> str | None:
    # NaN is in no range.
    if 0.0 <= value <= MAX_PACING_PER_MS:
        return None
    return (
        f"must be from 0 to {MAX_PACING_PER_MS:.0f} messages per millisecond, 0 for no pacing; "
        f"it is {value!r}"
    )


def period_fault(value: float) -> str | None:
    """Return why a report period is invalid; None if it is valid."""
    if PERIOD_S <= value <= MAX_PERIOD_S:
        return None
    return f"must be from {PERIOD_S:.0f} to {MAX_PERIOD_S:.0f} seconds, not {value!r}"


def aliases_of(value: Sequence[str]) -> dict[str, str]:
    """Parse ``stream=sensor``: sensor names by LSL stream names, in which ``*`` is any text."""
    pairs = (each.rpartition("=") for each in value if each)
    return {name.strip(): alias.strip() for name, _, alias in pairs}


def peers_of(value: Sequence[str]) -> tuple[str, ...]:
    """Return the host names; ROS has no empty list, so an empty name is ignored."""
    return tuple(peer for peer in value if peer)


def _aliases_fault(value: Sequence[str]) -> str | None:
    for name, alias in aliases_of(value).items():
        if not name or not _ALIAS.fullmatch(alias):
            return (
                "must look like [UN-2019*=unicorn]: the name of an LSL stream and a name of "
                f"letters, digits and single underscores; it has {f'{name}={alias}'!r}"
            )
    return None


def _compat_fault(value: str) -> str | None:
    return None if value in ("", SMARTLAB) else f"must be {SMARTLAB} or empty, not {value!r}"


_PARAMETERS = {
    TOPIC_PREFIX: _Parameter(
        "biosensors", "first part of every topic, relative to the namespace", _prefix_fault
    ),
    STREAM_PREDICATE: _Parameter(
        "", "LSL query of the streams that this node serves; empty: all", _query_fault
    ),
    BURST_PACING: _Parameter(
        PACING_PER_MS,
        "messages of one topic per millisecond, from a burst: more overrun subscribers' queues, "
        "usually 5 or 10 long; 0: all at once",
        _pacing_fault,
        most=MAX_PACING_PER_MS,
    ),
    ALIASES: _Parameter(
        [""],
        "names of sensors for streams of other programs, such as [UN-2019*=unicorn]",
        _aliases_fault,
        read_only=True,
    ),
    COMPAT: _Parameter(
        "",
        "smartlab: types and values of ros2-foxy-wearable-biosensors, for its clients",
        _compat_fault,
        read_only=True,
    ),
    DIAGNOSTICS_PERIOD: _Parameter(
        PERIOD_S, PERIOD_TEXT, period_fault, least=PERIOD_S, most=MAX_PERIOD_S
    ),
    SESSION_ID: _Parameter(
        "", "LSL session; empty: LSL's own setting", lambda _: None, read_only=True
    ),
    KNOWN_PEERS: _Parameter(
        [""], "hosts that multicast does not reach", lambda _: None, read_only=True
    ),
}


TEXTS = {name: each.description for name, each in _PARAMETERS.items()}
"""Descriptions of the parameters, by name."""
# Of ROS itself, or shared by nodes in one file for all of them.
_OF_ROS = (USE_SIM_TIME, "start_type_description_service")
_SHARED = (QOS_OVERRIDES, "diagnostic_updater.")


def is_of_ros(name: str) -> bool:
    """Whether a parameter belongs to ROS itself, so that every node must accept it."""
    return name in _OF_ROS or name.startswith(_SHARED)


def unknown(name: str, known: Iterable[str]) -> str:
    """Return the sentence about a parameter that a node does not have."""
    similar = get_close_matches(name, known, n=1)
    if similar:
        return f"{name} is not a parameter of this node; {similar[0]} is"
    return (
        f"{name} is not a parameter of this node; --help lists those that are, and parameters of "
        "another node in a file belong below that node's name, not below /**"
    )


def declare(node: Node, name: str) -> Any:  # noqa: ANN401 - a string or a list of them
    """Declare one parameter; its value in a file or on the command line must be valid."""
    parameter = _PARAMETERS[name]
    given = node.get_parameter_or(name).value
    if given is not None:
        node.undeclare_parameter(name)
    value: Any = parameter.default if given is None else given
    if isinstance(parameter.default, float):
        # YAML and the command line parse 1 as an integer, which ROS refuses for a float.
        value = float(value)
    return node.declare_parameter(name, value, parameter.descriptor, ignore_override=True).value


def is_known(name: str) -> bool:
    """Whether :func:`fault` can validate a parameter of this name."""
    return name in _PARAMETERS or name == USE_SIM_TIME or name.startswith(QOS_OVERRIDES)


def fault(name: str, value: object) -> str | None:
    """Return why a value is refused; None if it is valid."""
    if name.startswith(QOS_OVERRIDES):
        return _qos_fault(name, value)
    if name == USE_SIM_TIME:
        return None if isinstance(value, bool) else f"{name} must be true or false, not {value!r}"
    parameter = _PARAMETERS[name]
    reason = _type_fault(parameter.default, value) or parameter.fault(value)
    return reason and f"{name} {reason}"


def _type_fault(
    default: str | float | list[str],
    value: object,
) -> str | None:
    if isinstance(default, str):
        return None if isinstance(value, str) else f"must be text, not {value!r}"
    if isinstance(default, float):
        is_number = isinstance(value, int | float) and not isinstance(value, bool)
        return None if is_number else f"must be a number such as {default}, not {value!r}"
    return None if _is_text_list(value) else f"must be a list of texts, not {value!r}"


def _is_text_list(value: object) -> TypeGuard[Sequence[str]]:
    if not isinstance(value, Sequence) or isinstance(value, (str, bytes)):
        return False
    return all(isinstance(item, str) for item in cast("Sequence[object]", value))


def _qos_fault(name: str, value: object) -> str | None:
    """Validate ``qos_overrides.<topic>.publisher.<policy>``."""
    owner, _, policy = name.rpartition(".")
    if not owner.endswith(".publisher"):
        return None
    if policy == "depth":
        is_number = isinstance(value, int) and not isinstance(value, bool)
        if is_number and value in range(1, MAX_DEPTH + 1):
            return None
        return f"{name} must be an integer from 1 to {MAX_DEPTH}, not {value!r}"
    values = _QOS_VALUES.get(policy)
    if values is None:
        return f"{name}: only depth, {', '.join(_QOS_VALUES)} can be overridden"
    return None if value in values else f"{name} must be one of {', '.join(values)}, not {value!r}"
