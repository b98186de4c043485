"""The parameters of ``ros_to_lsl``; they are read at the start, and errors end the program."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum, unique
from functools import partial
from typing import Any, NamedTuple, cast

from rcl_interfaces.msg import ParameterDescriptor, ParameterType, SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter

from biosensor_common.errors import ConfigError, ConfigReason
from lsl_to_ros.command_line import page
from lsl_to_ros.parameters.node import (
    DIAGNOSTICS_PERIOD,
    KNOWN_PEERS,
    PERIOD_S,
    PERIOD_TEXT,
    SESSION_ID,
    USE_SIM_TIME,
    is_of_ros,
    period_fault,
    unknown,
)


@unique
class SendAs(StrEnum):
    """How a topic's messages are sent."""

    AUTO = ""
    """Numbers as samples, and text next to them as markers when it changes; else markers."""
    SAMPLES = "samples"
    MARKERS = "markers"
    """One marker per message: its only field, or the whole message as JSON."""
    JSON = "json"
    """One marker per message, the whole message as JSON."""


@dataclass(frozen=True, slots=True)
class TopicRequest:
    """A topic to send, as the parameters request it."""

    topic: str  # Full name.
    name: str  # Of the stream.
    send_as: SendAs = SendAs.AUTO
    fields: tuple[str, ...] = ()  # Fields of the message to send; all if empty.
    rate: float = 0.0  # Nominal rate in Hz; 0 for an irregular stream.
    type_name: str = ""  # Type of the message; if empty, the publishers define it.


@dataclass(frozen=True, slots=True)
class Requests:
    """The topics to send, as the parameters request them."""

    topics: tuple[TopicRequest, ...] = ()
    # Whether to send every other topic, too, except those with unbounded bytes.
    all_small: bool = False
    by_arrival: bool = False  # Whether to stamp everything with its arrival time.


def stream_name(topic: str) -> str:
    """Return a stream's name for a topic: ``robot-odom`` for ``/robot/odom``.

    Topics contain no hyphens, so different topics have different names.
    """
    return topic.strip("/").replace("/", "-")


TOPICS, ALL_SMALL, STAMPS = "topics", "all_small", "stamps"
MEASURED, ARRIVAL = "measured", "arrival"
AS, FIELDS, NAME, RATE, TYPE = "as", "fields", "name", "rate", "type"
# Receivers make room for six minutes at the nominal rate.
MAX_RATE_HZ = 10_000
_STREAM_NAME = re.compile(r"[A-Za-z0-9_-]{1,100}")
_TYPE_NAME = re.compile(r"[a-z][a-z0-9_]*/(msg/)?[A-Z][A-Za-z0-9]*")


class Option(NamedTuple):
    """Declaration of a parameter."""

    default: str | float | bool | list[str]  # Default value, whose type is the parameter's type.
    text: str  # Description for `ros2 param describe` and `--help`.


NODE_OPTIONS: Mapping[str, Option] = {
    TOPICS: Option([""], "topics to send, as a list: [/joint_states, /odom]"),
    ALL_SMALL: Option(False, "send every topic except images and other bytes without a size limit"),
    STAMPS: Option(
        MEASURED,
        "measured: header, otherwise source timestamp, otherwise arrival; arrival: always arrival",
    ),
    DIAGNOSTICS_PERIOD: Option(PERIOD_S, PERIOD_TEXT),
    SESSION_ID: Option("", "LSL session; empty: LSL's own setting"),
    KNOWN_PEERS: Option([""], "hosts that multicast does not reach"),
}
TOPIC_OPTIONS: Mapping[str, Option] = {
    AS: Option("", "samples, markers or json (whole messages); otherwise the type decides"),
    FIELDS: Option([""], "fields to send, or groups of them: [pose.pose.position]; otherwise all"),
    NAME: Option("", "of the LSL stream; otherwise the topic's, robot-odom for /robot/odom"),
    RATE: Option(0.0, "nominal rate in Hz of the LSL stream; 0: irregular"),
    TYPE: Option("", "message type, to subscribe before anything is published"),
}
_SIMULATED = Option(False, "of ROS itself")
_TYPES: dict[type[Any], int] = {
    bool: ParameterType.PARAMETER_BOOL,
    float: ParameterType.PARAMETER_DOUBLE,
    list: ParameterType.PARAMETER_STRING_ARRAY,
    str: ParameterType.PARAMETER_STRING,
}


def read_requests(node: Node, resolve: Callable[[str], str]) -> Requests:
    """Declare every parameter and return the requests.

    Parameters
    ----------
    resolve
        Full name of a topic; raises RuntimeError, TypeError or ValueError where there is none.

    Raises
    ------
    ConfigError
        ``UNKNOWN_KEY`` or ``WRONG_VALUE``, with a sentence for the user.
    """
    given = {name: each.value for name, each in node.get_parameters_by_prefix("").items()}
    requests = requests_of(given, resolve)
    values = {name: _value(given, name, option) for name, option in NODE_OPTIONS.items()}
    of_topics = {
        f"{topic}.{name}": _value(given, f"{topic}.{name}", option)
        for topic in _topics(values[TOPICS])
        for name, option in TOPIC_OPTIONS.items()
    }
    _declare(node, values | of_topics)
    # Declared ones are read-only; others would be accepted, because undeclared ones are allowed.
    node.add_on_set_parameters_callback(partial(_refuse_wrong, values=values))
    return requests


def _refuse_wrong(
    parameters: Iterable[Parameter], *, values: Mapping[str, Any]
) -> SetParametersResult:
    """Refuse unknown parameters that are set while the node runs."""
    try:
        for each in parameters:
            _check_known(each.name, _topics(values[TOPICS]))
            if each.name == USE_SIM_TIME:
                _check_stamps(values[STAMPS], use_sim_time=bool(each.value))
    except ConfigError as error:
        return SetParametersResult(successful=False, reason=str(error))
    return SetParametersResult(successful=True)


def requests_of(given: Mapping[str, Any], resolve: Callable[[str], str]) -> Requests:
    """Convert parameter values to requests; raises as :func:`read_requests` does.

    Parameters
    ----------
    given
        Values of ROS, by name.
    resolve
        Full name of a topic; raises RuntimeError, TypeError or ValueError where there is none.
    """
    topics = _topics(_value(given, TOPICS, NODE_OPTIONS[TOPICS]))
    for name in given:
        _check_known(name, topics)
    values = {name: _value(given, name, option) for name, option in NODE_OPTIONS.items()}
    requests = tuple(_request(topic, given, resolve) for topic in topics)
    _check_names(requests)
    if reason := period_fault(values[DIAGNOSTICS_PERIOD]):
        raise _wrong(f"{DIAGNOSTICS_PERIOD} {reason}")
    _check_stamps(values[STAMPS], use_sim_time=_value(given, USE_SIM_TIME, _SIMULATED))
    if not requests and not values[ALL_SMALL]:
        message = (
            'there is nothing to send: name topics, such as -p topics:="[/joint_states]", or'
            " set all_small:=true"
        )
        raise ConfigError(ConfigReason.NOT_FOUND, message)
    return Requests(requests, values[ALL_SMALL], by_arrival=values[STAMPS] == ARRIVAL)


def _topics(value: Sequence[str]) -> list[str]:
    topics = [topic for topic in value if topic]
    for topic in topics:
        if topics.count(topic) > 1:
            raise _wrong(f"{TOPICS} has {topic} twice")
        if "." in topic:
            raise _wrong(f"{TOPICS}: {topic!r} is not a topic name")
    return topics


def _check_known(name: str, topics: Sequence[str]) -> None:
    if name in NODE_OPTIONS or is_of_ros(name):
        return
    topic, _, option = name.rpartition(".")
    if topic in topics and option in TOPIC_OPTIONS:
        return
    if topic and topic not in topics:
        message = (
            f"{name}: {topic} is not among the topics; add it to {TOPICS} with the same spelling"
        )
    elif topic:
        message = f"{name}: a topic has no {option!r}; it has {', '.join(TOPIC_OPTIONS)}"
    else:
        message = unknown(name, NODE_OPTIONS)
    raise ConfigError(ConfigReason.UNKNOWN_KEY, message)


def _value(given: Mapping[str, Any], name: str, option: Option) -> Any:  # noqa: ANN401 - of the option's type
    value = given.get(name)
    if value is None:
        return option.default
    default = option.default
    if isinstance(default, bool):
        return _right(name, value, isinstance(value, bool), "true or false")
    if isinstance(default, float):
        is_number = isinstance(value, int | float) and not isinstance(value, bool)
        return float(_right(name, value, is_number, "a number"))
    if isinstance(default, str):
        return _right(name, value, isinstance(value, str), "text")
    is_list = isinstance(value, Sequence) and not isinstance(value, str | bytes)
    items = list(cast("Sequence[object]", value)) if is_list else []
    is_text = is_list and all(isinstance(item, str) for item in items)
    _right(name, value, is_text, "a list of names such as [a, b]")
    return items


def _right(name: str, value: Any, is_right: bool, what: str) -> Any:  # noqa: ANN401 - as above
    if not is_right:
        raise _wrong(f"{name} must be {what}, not {value!r}")
    return value


def _request(topic: str, given: Mapping[str, Any], resolve: Callable[[str], str]) -> TopicRequest:
    value = {
        name: _value(given, f"{topic}.{name}", option) for name, option in TOPIC_OPTIONS.items()
    }
    try:
        full = resolve(topic)
    except (RuntimeError, TypeError, ValueError) as error:
        raise _wrong(f"{TOPICS}: {topic!r} is not a topic name") from error
    name = value[NAME] or stream_name(full)
    if not _STREAM_NAME.fullmatch(name):
        raise _wrong(
            f"{topic}.{NAME} must consist of at most 100 letters, digits, _ and -, not {name!r}"
        )
    if value[AS] not in list(SendAs):
        raise _wrong(f"{topic}.{AS} must be samples, markers or json, not {value[AS]!r}")
    if not 0 <= value[RATE] <= MAX_RATE_HZ:
        raise _wrong(f"{topic}.{RATE} must be from 0 to {MAX_RATE_HZ} Hz, not {value[RATE]!r}")
    if value[TYPE] and not _TYPE_NAME.fullmatch(value[TYPE]):
        raise _wrong(f"{topic}.{TYPE} must look like std_msgs/msg/String, not {value[TYPE]!r}")
    fields = tuple(each for each in value[FIELDS] if each)
    return TopicRequest(full, name, SendAs(value[AS]), fields, value[RATE], value[TYPE])


def _check_names(requests: Sequence[TopicRequest]) -> None:
    names: dict[str, str] = {}
    for each in requests:
        other = names.setdefault(each.name, each.topic)
        if other != each.topic:
            raise _wrong(
                f"{other} and {each.topic} would both be the stream {each.name}; give one of "
                "them a name"
            )


def _check_stamps(stamps: str, *, use_sim_time: bool) -> None:
    if stamps not in (MEASURED, ARRIVAL):
        raise _wrong(f"{STAMPS} must be {MEASURED} or {ARRIVAL}, not {stamps!r}")
    if use_sim_time and stamps != ARRIVAL:
        raise _wrong(
            f"{USE_SIM_TIME}: simulated time cannot be converted to the LSL clock; leave it out, "
            f"or use arrival times with {STAMPS}:={ARRIVAL}"
        )


def _declare(node: Node, values: Mapping[str, Any]) -> None:
    """Declare the parameters for ``ros2 param``, as read-only."""
    for name, value in values.items():
        option = NODE_OPTIONS.get(name) or TOPIC_OPTIONS[name.rpartition(".")[2]]
        if node.has_parameter(name):
            node.undeclare_parameter(name)
        descriptor = ParameterDescriptor(
            description=option.text, read_only=True, type=_TYPES[type(option.default)]
        )
        node.declare_parameter(name, value, descriptor, ignore_override=True)


def _wrong(message: str) -> ConfigError:
    return ConfigError(ConfigReason.WRONG_VALUE, message)


_BEGIN = """\
Send topics of ROS 2 as streams of the Lab Streaming Layer.

  ros2 run lsl_to_ros ros_to_lsl --ros-args -p topics:="[/joint_states, /odom]"
  ros2 run lsl_to_ros ros_to_lsl --ros-args --params-file ros_to_lsl.yaml
"""
_OF_TOPIC = 'For one topic in "topics", as in -p /odom.name:=pose:'


def usage() -> str:
    """Return the help, for a console of 80 columns."""
    of_node = {name: each.text for name, each in NODE_OPTIONS.items()}
    of_topic = {f"TOPIC.{name}": each.text for name, each in TOPIC_OPTIONS.items()}
    return page(_BEGIN, {"Parameters:": of_node, _OF_TOPIC: of_topic})
