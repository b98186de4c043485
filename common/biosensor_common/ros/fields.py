"""Lists the fields of a message type, with the units and quantities of well-known types.

The types are defined by rclpy or a bag file. Units are those of REP 103
(https://www.ros.org/reps/rep-0103.html): metres, radians, seconds, newtons. The table names the
outermost type that defines a quantity: a ``Vector3`` alone has no unit, but the one in
``Twist.linear`` has. Channel types are those of XDF's MoCap pages
(https://github.com/sccn/xdf/wiki/MoCap-Meta-Data).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from enum import Enum, unique
from typing import NamedTuple, Protocol


class Quantity(NamedTuple):
    """Physical quantity of a channel.

    Attributes
    ----------
    unit
        Empty if the type does not define one.
    kind
        XDF's channel type, without the axis.
    """

    unit: str = ""
    kind: str = ""


NOTHING_KNOWN = Quantity()
TIME = Quantity("s", "Time")
# No unit: radians for a revolute joint, metres for a prismatic one.
_JOINT_POSITION, _JOINT_VELOCITY = Quantity("", "JointPosition"), Quantity("", "JointVelocity")
_JOINT_ACCELERATION = Quantity("", "JointAcceleration")
_JOINT_EFFORT = Quantity("", "JointEffort")
_POSITION, _ORIENTATION = Quantity("m", "Position"), Quantity("none", "Orientation")
_VELOCITY, _TURN = Quantity("m/s", "Velocity"), Quantity("rad/s", "AngularVelocity")
_ACCELERATION = Quantity("m/s^2", "Acceleration")
_TURN_ACCELERATION = Quantity("rad/s^2", "AngularAcceleration")
_FORCE, _TORQUE = Quantity("N", "Force"), Quantity("Nm", "Torque")
_ANGLE, _DISTANCE = Quantity("rad", "Angle"), Quantity("m", "Distance")
_SPAN = Quantity("s", "Duration")
_VOLTAGE, _CURRENT = Quantity("V", "Voltage"), Quantity("A", "Current")
_CHARGE, _FRACTION = Quantity("Ah", "Charge"), Quantity("fraction", "Fraction")
_TEMPERATURE = Quantity("celsius", "TEMPERATURE")

_KNOWN: dict[str, dict[str, Quantity]] = {
    "geometry_msgs/msg/Accel": {"linear": _ACCELERATION, "angular": _TURN_ACCELERATION},
    "geometry_msgs/msg/Inertia": {
        "m": Quantity("kg", "Mass"),
        "com": _POSITION,
        **dict.fromkeys(("ixx", "ixy", "ixz", "iyy", "iyz", "izz"), Quantity("kg m^2", "Inertia")),
    },
    "geometry_msgs/msg/Point": dict.fromkeys("xyz", _POSITION),
    "geometry_msgs/msg/Point32": dict.fromkeys("xyz", _POSITION),
    "geometry_msgs/msg/Pose2D": {"x": _POSITION, "y": _POSITION, "theta": _ANGLE},
    "geometry_msgs/msg/Quaternion": dict.fromkeys("xyzw", _ORIENTATION),
    "geometry_msgs/msg/Transform": {"translation": _POSITION},
    "geometry_msgs/msg/Twist": {"linear": _VELOCITY, "angular": _TURN},
    "geometry_msgs/msg/Wrench": {"force": _FORCE, "torque": _TORQUE},
    "nav_msgs/msg/MapMetaData": {"resolution": Quantity("m", "Distance")},
    "sensor_msgs/msg/BatteryState": {
        "voltage": _VOLTAGE,
        "temperature": _TEMPERATURE,
        "current": _CURRENT,
        "charge": _CHARGE,
        "capacity": _CHARGE,
        "design_capacity": _CHARGE,
        "percentage": _FRACTION,
        "cell_voltage": _VOLTAGE,
        "cell_temperature": _TEMPERATURE,
    },
    "sensor_msgs/msg/FluidPressure": {"fluid_pressure": Quantity("Pa", "Pressure")},
    "sensor_msgs/msg/Illuminance": {"illuminance": Quantity("lux", "Illuminance")},
    "sensor_msgs/msg/Imu": {"angular_velocity": _TURN, "linear_acceleration": _ACCELERATION},
    "sensor_msgs/msg/JointState": {
        "position": _JOINT_POSITION,
        "velocity": _JOINT_VELOCITY,
        "effort": _JOINT_EFFORT,
    },
    "sensor_msgs/msg/LaserScan": {
        "angle_min": _ANGLE,
        "angle_max": _ANGLE,
        "angle_increment": _ANGLE,
        "time_increment": _SPAN,
        "scan_time": _SPAN,
        "range_min": _DISTANCE,
        "range_max": _DISTANCE,
        "ranges": _DISTANCE,
    },
    "sensor_msgs/msg/MagneticField": {"magnetic_field": Quantity("T", "MagneticField")},
    "sensor_msgs/msg/NavSatFix": {
        "latitude": Quantity("deg", "Latitude"),
        "longitude": Quantity("deg", "Longitude"),
        "altitude": Quantity("m", "Altitude"),
    },
    "sensor_msgs/msg/Range": {
        "field_of_view": _ANGLE,
        "min_range": _DISTANCE,
        "max_range": _DISTANCE,
        "range": _DISTANCE,
    },
    "sensor_msgs/msg/RelativeHumidity": {"relative_humidity": _FRACTION},
    "sensor_msgs/msg/Temperature": {"temperature": _TEMPERATURE},
    "trajectory_msgs/msg/JointTrajectoryPoint": {
        "positions": _JOINT_POSITION,
        "velocities": _JOINT_VELOCITY,
        "accelerations": _JOINT_ACCELERATION,
        "effort": _JOINT_EFFORT,
    },
}
_QUATERNION_AXES = {"w": "A", "x": "B", "y": "C", "z": "D"}


def quantity(message_type: str, field: str) -> Quantity | None:
    """Return the quantity of a type's field; None if the type does not define it."""
    return _KNOWN.get(message_type, {}).get(field)


def channel_type(measured: Quantity, field: str) -> str:
    """Return XDF's channel type of a number, with its axis: ``PositionX``, ``OrientationA``."""
    if measured == _ORIENTATION:
        return measured.kind + _QUATERNION_AXES.get(field, "")
    return measured.kind + field.upper() if field in ("x", "y", "z") else measured.kind


HEADER = "header"
HEADER_TYPE = "std_msgs/msg/Header"
NAMES = ("name", "names", "joint_names")
"""Lists of text that name the elements of the other sequences of their message."""
# Dummy field of messages without fields in Python.
_NO_FIELD = "structure_needs_at_least_one_member"
_LAYOUT = "/MultiArrayLayout"
"""Layout of a MultiArray; its labels are not text for markers."""
_CLOUDS = {"sensor_msgs/msg/PointCloud": "points"}
"""Types of bulk data that are not byte arrays."""
_TIMES = ("builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration")
_TEXTS = ("string", "wstring")
_WIDE = ("int64", "uint64")
# A ``byte`` of the definition is called ``octet`` by rclpy and ``byte`` by the bag library.
_BYTE = ("octet", "byte")
_BYTES = (*_BYTE, "uint8", "int8", "char")


class Slot(NamedTuple):
    """One entry of a message's definition.

    Attributes
    ----------
    base
        ``float64``, ``string`` and so on; empty for a message.
    message
        Definition of a nested message; None otherwise.
    size
        Length of a fixed array; None for a sequence; 1 for a single value.
    has_limit
        Whether it is a bounded sequence.
    values
        Names of its values, if the type has constants for them.
    """

    name: str
    base: str = ""
    message: Definition | None = None
    size: int | None = 1
    is_array: bool = False
    has_limit: bool = False
    values: Mapping[int, str] = {}


class Definition(Protocol):
    """The definition of a message type."""

    @property
    def name(self) -> str:
        """Full name of the type: ``sensor_msgs/msg/JointState``."""
        ...

    def slots(self) -> Iterable[Slot]:
        """Return the entries in their order."""
        ...


@unique
class FieldKind(Enum):
    """Kind of a field's values."""

    NUMBER = "number"
    """A number; booleans are 0 and 1."""
    BYTE = "byte"
    """A ``byte`` of the definition, which Python may represent as ``bytes``."""
    TIME = "time"
    """Seconds and nanoseconds."""
    TEXT = "text"
    MESSAGE = "message"
    """An array of messages, whose elements have fields."""


@dataclass(frozen=True, slots=True)
class Field:
    """One field, or an array of them.

    Attributes
    ----------
    path
        Attribute path within the message: ``pose.pose.position.x``.
    size
        Length of a fixed array; None for a sequence, whose length varies; 1 for a single value.
    is_wide
        Whether a 64-bit float cannot represent all of its values.
    is_blob
        Whether it is an unbounded sequence of bytes: an image, a point cloud.
    elements
        Fields of each element of an array of messages.
    values
        Names of the values, if the field is an enumeration.
    """

    path: str
    kind: FieldKind
    size: int | None = 1
    is_array: bool = False
    measured: Quantity = NOTHING_KNOWN
    is_wide: bool = False
    is_blob: bool = False
    elements: tuple[Field, ...] = ()
    values: Mapping[int, str] = field(default_factory=dict[int, str])

    @property
    def name(self) -> str:
        """The last part of the path."""
        return self.path.rpartition(".")[2]


def fields_of(definition: Definition) -> tuple[Field, ...]:
    """Return the fields of a type in their order, with nested messages flattened.

    The message's own header and the layout of a MultiArray are left out.
    """
    return tuple(_walk(definition, "", NOTHING_KNOWN))


def has_header(definition: Definition) -> bool:
    """Whether messages of a type have a stamped header."""
    return any(_is_header(slot) for slot in definition.slots())


def bulk_of(definition: Definition) -> str:
    """Return the name of a field with bulk data, such as images or point clouds; else empty.

    Bytes in a MultiArray are not bulk data: they are numbers that somebody chose to send.
    """
    if any(_is_layout(slot) for slot in definition.slots()):
        return ""
    for each in fields_of(definition):
        if any(inside.is_blob for inside in all_fields((each,))):
            return each.path
    return _CLOUDS.get(definition.name, "")


def all_fields(fields: tuple[Field, ...]) -> Iterator[Field]:
    """Iterate over fields, including those of array elements."""
    for each in fields:
        yield each
        yield from all_fields(each.elements)


def _walk(definition: Definition, before: str, inherited: Quantity) -> Iterator[Field]:
    for slot in definition.slots():
        if (not before and _is_header(slot)) or _is_layout(slot) or slot.name == _NO_FIELD:
            continue
        measured = quantity(definition.name, slot.name) or inherited
        path = f"{before}{slot.name}"
        kind = _kind(slot)
        if kind is FieldKind.MESSAGE and not slot.is_array:
            assert slot.message is not None
            yield from _walk(slot.message, f"{path}.", measured)
        else:
            yield _field(slot, path, kind, measured)


def _field(slot: Slot, path: str, kind: FieldKind, measured: Quantity) -> Field:
    is_message = kind is FieldKind.MESSAGE
    return Field(
        path,
        kind,
        size=slot.size,
        is_array=slot.is_array,
        measured=TIME if kind is FieldKind.TIME else measured,
        is_wide=slot.base in _WIDE,
        is_blob=slot.size is None and not slot.has_limit and slot.base in _BYTES,
        elements=tuple(_walk(slot.message, "", measured)) if slot.message and is_message else (),
        values=slot.values if kind is FieldKind.NUMBER else {},
    )


def _kind(slot: Slot) -> FieldKind:
    if slot.message is not None:
        return FieldKind.TIME if slot.message.name in _TIMES else FieldKind.MESSAGE
    if slot.base in _TEXTS:
        return FieldKind.TEXT
    return FieldKind.BYTE if slot.base in _BYTE else FieldKind.NUMBER


def _is_header(slot: Slot) -> bool:
    is_header = slot.name == HEADER and not slot.is_array
    return is_header and slot.message is not None and slot.message.name == HEADER_TYPE


def _is_layout(slot: Slot) -> bool:
    return slot.message is not None and slot.message.name.endswith(_LAYOUT)
