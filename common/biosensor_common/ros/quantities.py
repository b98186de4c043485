"""Units and quantities of well-known message types, after REP 103.

REP 103 (https://www.ros.org/reps/rep-0103.html) has SI units: metres, radians, seconds,
newtons. The table names the outermost type that defines a quantity: a ``Vector3`` alone has no
unit, but the one in ``Twist.linear`` has. Channel types are those of XDF's MoCap pages
(https://github.com/sccn/xdf/wiki/MoCap-Meta-Data), where quaternions are A (w), B, C, D.
"""

from __future__ import annotations

from typing import NamedTuple


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
