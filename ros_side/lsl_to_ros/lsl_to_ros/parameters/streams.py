"""``Sensor_Enable``, ``Chunk_Enable``, ``Chunk_Length``: defaults, and per sensor and data.

The names are the original framework's. A key may stand alone (for everything),
behind a sensor (``zephyr.Chunk_Length``) or behind a sensor and data name
(``zephyr.ecg.Chunk_Length``); with a participant in front and with the label
behind the sensor where there are any (``p01.empatica_e4_left.bvp.Chunk_Enable``).
The most specific key wins. Keys of streams that are not present yet can be set, too.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

from rcl_interfaces.msg import (
    IntegerRange,
    ParameterDescriptor,
    ParameterType,
    SetParametersResult,
)
from rclpy.node import Node
from rclpy.parameter import Parameter

from biosensor_common import naming
from biosensor_common.errors import ConfigError, ConfigReason
from biosensor_common.spec import DeviceIdentity
from lsl_to_ros.command_line import page
from lsl_to_ros.parameters import node as node_parameters
from lsl_to_ros.parameters.node import QOS_OVERRIDES

SENSOR_ENABLE, CHUNK_ENABLE, CHUNK_LENGTH = "Sensor_Enable", "Chunk_Enable", "Chunk_Length"
LENGTH_RANGE = range(1, 100_001)
DEFAULTS: dict[str, bool | int] = {SENSOR_ENABLE: True, CHUNK_ENABLE: True, CHUNK_LENGTH: 128}

REMOVED = {
    "processes": "the node runs in one process; divide the streams among several nodes "
    "(stream_predicate), or read fast topics as _chunk or _stamped"
}
"""Removed parameters, and their replacements."""
# ``ros2 param dump`` writes these values for keys that are not set, and parameter files and
# ``ros2 param load`` pass them on.
_UNSET = ("null", "None")

TEXTS = {
    SENSOR_ENABLE: "publish any topics: raw, chunk and hardware",
    CHUNK_ENABLE: "publish chunk topics; also needs Sensor_Enable",
    CHUNK_LENGTH: "samples in one chunk",
}


@dataclass(frozen=True, slots=True)
class StreamSettings:
    """Values of the parameters for one stream."""

    raw: bool  # Publish every sample.
    chunk: bool  # Publish chunks: the chunk name's `Sensor_Enable` and `Chunk_Enable`.
    chunk_length: int


class Parameters:
    """The node's stream parameters, validated, and changeable while it runs.

    Parameters
    ----------
    node
        Must allow undeclared parameters, so that unknown sensors can have parameters.

    Raises
    ------
    ConfigError
        If a parameter of a file or the command line is wrong or misspelt.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._on_change: Callable[[], None] = lambda: None
        self._on_set: Callable[[Sequence[Parameter]], None] = lambda _: None
        self._asked_for: set[str] = set()
        # Allowed prefixes of a key: sensors, and sensors with a data name.
        self._owners: set[str] = set()
        self._sensors: set[str] = set()
        self._is_declaring = False
        self._check_given()
        for key, value in DEFAULTS.items():
            given = node.get_parameter_or(key).value
            if given is not None:
                node.undeclare_parameter(key)
            chosen = value if given is None else given
            node.declare_parameter(key, chosen, _descriptor(key), ignore_override=True)
        node.add_pre_set_parameters_callback(self._asked)
        node.add_on_set_parameters_callback(self._validate)
        node.add_post_set_parameters_callback(self._changed)

    def on_change(self, listener: Callable[[], None]) -> None:
        """Call *listener* after any of them changed."""
        self._on_change = listener

    def on_set(self, listener: Callable[[Sequence[Parameter]], None]) -> None:
        """Call *listener* with parameters that a user has set, after their validation."""
        self._on_set = listener

    def settings(self, identity: DeviceIdentity, data_name: str, chunk: str) -> StreamSettings:
        """Return the present settings of one stream; *chunk* is its chunk's data name."""
        chunk = chunk or data_name
        return StreamSettings(
            raw=bool(self._value(SENSOR_ENABLE, identity, data_name)),
            chunk=bool(
                self._value(SENSOR_ENABLE, identity, chunk)
                and self._value(CHUNK_ENABLE, identity, chunk)
            ),
            chunk_length=int(self._value(CHUNK_LENGTH, identity, chunk)),
        )

    def declare(self, identity: DeviceIdentity, data_name: str, chunk: str) -> None:
        """Make the keys of a stream visible to ``ros2 param list``, without setting them."""
        for each in filter(None, (data_name, chunk)):
            names = prefixes(identity, each)
            self._owners.update(names)
            self._sensors.update(names[len(names) // 2 :])
        self._is_declaring = True
        try:
            self._declare(prefixes(identity, data_name)[-1], data_name, chunk)
        finally:
            self._is_declaring = False

    def without_stream(self, parameters: Iterable[Parameter]) -> list[str]:
        """Return sentences about keys without a stream so far: they may be misspelt, or early."""
        known = ", ".join(sorted(self._sensors))
        seen = f"seen so far: {known}" if known else "none has arrived so far"
        return [
            f"{each.name} applies to no stream yet ({seen})"
            for each in parameters
            if each.value is not None
            and each.name.rpartition(".")[2] in DEFAULTS
            and "." in each.name
            and each.name.rpartition(".")[0] not in self._owners
        ]

    def _declare(self, sensor: str, data_name: str, chunk: str) -> None:
        for owner, keys in (
            (sensor, tuple(DEFAULTS)),
            (f"{sensor}.{naming.sanitise(data_name)}", (SENSOR_ENABLE,)),
            (f"{sensor}.{naming.sanitise(chunk)}", tuple(DEFAULTS) if chunk else ()),
        ):
            for key in keys:
                name = f"{owner}.{key}"
                descriptor = _descriptor(key, dynamic=True)
                if self._node.has_parameter(name):
                    # A key that was set before its sensor was known has no description yet.
                    self._node.set_descriptor(name, descriptor)
                else:
                    # An invalid value of a parameter file was dropped and must not come back.
                    self._node.declare_parameter(name, None, descriptor, ignore_override=True)

    def _value(self, key: str, identity: DeviceIdentity, data_name: str) -> bool | int:
        for prefix in prefixes(identity, data_name):
            name = f"{prefix}.{key}"
            if self._node.has_parameter(name):
                value = self._node.get_parameter(name).value
                if value is not None:
                    return value
        return self._node.get_parameter(key).value

    def _check_given(self) -> None:
        """Check values from a file or the command line, for which no callback is called."""
        given: dict[str, object] = {}
        for name, parameter in self._node.get_parameters_by_prefix("").items():
            if name in REMOVED:
                self._node.get_logger().error(f"{_unknown(name)}; it is ignored")
            if name in REMOVED or _is_unset(parameter):
                self._node.undeclare_parameter(name)
            else:
                given[name] = parameter.value
        check(given)

    def _validate(self, parameters: Iterable[Parameter]) -> SetParametersResult:
        faults = (_fault(parameter.name, parameter.value) for parameter in parameters)
        reason = next((fault for fault in faults if fault is not None), "")
        return SetParametersResult(successful=not reason, reason=reason)

    def _asked(self, parameters: list[Parameter]) -> list[Parameter]:
        """Record which parameters a user sets; rclpy does not call this for declarations."""
        self._asked_for = {parameter.name for parameter in parameters}
        return [Parameter(each.name) if _is_unset(each) else each for each in parameters]

    def _changed(self, parameters: Iterable[Parameter]) -> None:
        asked_for, self._asked_for = self._asked_for, set()
        given = [parameter for parameter in parameters if parameter.name in asked_for]
        if given:
            self._on_set(given)
        # For ROS, declaring is setting, and a hundred streams declare a thousand parameters.
        is_ours = any(not parameter.name.startswith(QOS_OVERRIDES) for parameter in parameters)
        if is_ours and not self._is_declaring:
            self._on_change()


def check(given: Mapping[str, object]) -> None:
    """Refuse wrong values and misspelt names.

    Raises
    ------
    ConfigError
        ``WRONG_VALUE``, with a sentence for the user.
    """
    for name, value in given.items():
        fault = _fault(name, value)
        if fault is not None:
            raise ConfigError(ConfigReason.WRONG_VALUE, fault)


def prefixes(identity: DeviceIdentity, data_name: str) -> list[str]:
    """Return the key prefixes of a stream, the most specific first."""
    plain = naming.sanitise(identity.sensor)
    sensors = [plain]
    if identity.label:
        sensors.insert(0, naming.sensor_topic_name(identity))
    if identity.participant:
        participant = naming.sanitise(identity.participant)
        sensors = [f"{participant}.{sensor}" for sensor in sensors] + sensors
    return [f"{sensor}.{naming.sanitise(data_name)}" for sensor in sensors] + sensors


def _is_unset(parameter: Parameter) -> bool:
    return parameter.name.rpartition(".")[2] in DEFAULTS and parameter.value in _UNSET


def _fault(name: str, value: object) -> str | None:
    """Return why a parameter is refused; None if it is valid or not of this node."""
    key = name.rpartition(".")[2]
    if node_parameters.is_known(name):
        return None if value is None else node_parameters.fault(name, value)
    if key not in DEFAULTS:
        return None if node_parameters.is_of_ros(name) else _unknown(name)
    if value is None:
        return None
    if key == CHUNK_LENGTH:
        if isinstance(value, bool) or not isinstance(value, int) or value not in LENGTH_RANGE:
            return f"{name} must be an integer from 1 to {LENGTH_RANGE[-1]}, not {value!r}"
    elif not isinstance(value, bool):
        return f"{name} must be true or false, not {value!r}"
    return None


def _unknown(name: str) -> str:
    if name in REMOVED:
        return f"{name} is no longer a parameter: {REMOVED[name]}"
    owner, _, _ = name.rpartition(".")
    known = {f"{owner}.{each}" if owner else each for each in DEFAULTS}
    return node_parameters.unknown(name, [*node_parameters.TEXTS, *sorted(known)])


def _descriptor(key: str, *, dynamic: bool = False) -> ParameterDescriptor:
    is_length = key == CHUNK_LENGTH
    limits = IntegerRange(from_value=LENGTH_RANGE[0], to_value=LENGTH_RANGE[-1], step=1)
    return ParameterDescriptor(
        description=TEXTS[key] + ("; not set: the less specific key applies" if dynamic else ""),
        type=ParameterType.PARAMETER_INTEGER if is_length else ParameterType.PARAMETER_BOOL,
        dynamic_typing=dynamic,
        integer_range=[limits] if is_length and not dynamic else [],
    )


_BEGIN = """\
Publish streams of the Lab Streaming Layer as topics of ROS 2.

  ros2 run lsl_to_ros lsl_to_ros
  ros2 run lsl_to_ros lsl_to_ros --ros-args -p Chunk_Length:=36
  ros2 run lsl_to_ros lsl_to_ros --ros-args --params-file lsl_to_ros.yaml
"""
_OF_STREAMS = "For all, or after a sensor and data name, as in SENSOR.DATA.Chunk_Length:"


def usage() -> str:
    """Return the help, for a console of 80 columns."""
    return page(_BEGIN, {"Parameters:": node_parameters.TEXTS, _OF_STREAMS: TEXTS})
