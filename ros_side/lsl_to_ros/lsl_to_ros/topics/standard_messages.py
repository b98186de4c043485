"""Topics of ``sensor_msgs`` beside our own, for streams that have such a message.

What a channel means is read from its role in the header, so a new sensor gets them too.
Values are in SI units as the messages demand. A covariance that is unknown is all
zeros, and one whose first element is -1 says that the quantity itself is missing:
that is the messages' own convention.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Iterable, Sequence
from typing import Any, ClassVar

import numpy as np
from geometry_msgs.msg import Quaternion, Vector3
from sensor_msgs.msg import BatteryState, Imu, MagneticField, Temperature
from std_msgs.msg import Header

from biosensor_common import standard_topics
from biosensor_common.quantities import (
    ACCELERATION,
    MAGNETIC_FIELD,
    ORIENTATION,
    ChannelRole,
)
from biosensor_common.standard_topics import STANDARD_GRAVITY
from biosensor_common.stream_header import StreamHeader
from lsl_to_ros.accounts.stamping import Stamping
from lsl_to_ros.lsl.blocks import Run
from lsl_to_ros.topics.publishers import TopicPublisher
from lsl_to_ros.topics.writers import Writer

_MISSING = [-1.0, *[0.0] * 8]
_UNKNOWN = [0.0] * 9


class StandardMessageWriter(Writer):
    """One message of ``sensor_msgs`` a sample.

    Attributes
    ----------
    message_class
        What it publishes.
    """

    message_class: ClassVar[type[Any]]

    def __init__(
        self, publisher: TopicPublisher, header: StreamHeader, frame_id: str, stamping: Stamping
    ) -> None:
        super().__init__(publisher)
        self._stream = header
        roles = enumerate(header.roles)
        self._columns = {role: column for column, role in roles if role is not None}
        self._frame_id = frame_id
        self._stamping = stamping

    @classmethod
    @abstractmethod
    def topic_of(cls, header: StreamHeader) -> str:
        """Return the data name of this message beside a stream, empty if it has none."""

    @abstractmethod
    def build(self, header: Header, sample: Sequence[float]) -> object:
        """Make a message of one sample."""

    def write(self, run: Run) -> None:
        """Publish each sample."""
        for sample, stamp in zip(run.samples, run.stamps, strict=True):
            header = Header(stamp=self._stamping.to_time(float(stamp)), frame_id=self._frame_id)
            self.publisher.publish(self.build(header, sample.astype(np.float64).tolist()))

    def _values(self, sample: Sequence[float], roles: Iterable[ChannelRole]) -> list[float]:
        return [sample[self._columns[role]] for role in roles]


class TemperatureWriter(StandardMessageWriter):
    """``<data>_temperature``; a variance of 0 means unknown."""

    message_class = Temperature

    @classmethod
    def topic_of(cls, header: StreamHeader) -> str:
        """See :meth:`StandardMessageWriter.topic_of`."""
        return standard_topics.temperature(header)

    def build(self, header: Header, sample: Sequence[float]) -> Temperature:
        """Make a message; both are in °C."""
        return Temperature(header=header, temperature=float(sample[0]), variance=0.0)


class BatteryStateWriter(StandardMessageWriter):
    """``<data>_state`` of a stream of the charge alone; ``bat_state`` of one among others."""

    message_class = BatteryState

    @classmethod
    def topic_of(cls, header: StreamHeader) -> str:
        """See :meth:`StandardMessageWriter.topic_of`."""
        return standard_topics.battery_state(header)

    def build(self, header: Header, sample: Sequence[float]) -> BatteryState:
        """Make a message: the charge as a fraction, NaN for all that is not measured."""
        (percent,) = self._values(sample, [ChannelRole.STATE_OF_CHARGE])
        return BatteryState(
            header=header,
            voltage=math.nan,
            temperature=math.nan,
            current=math.nan,
            charge=math.nan,
            capacity=math.nan,
            design_capacity=math.nan,
            percentage=_float32(percent / 100),
            power_supply_status=BatteryState.POWER_SUPPLY_STATUS_UNKNOWN,
            power_supply_health=BatteryState.POWER_SUPPLY_HEALTH_UNKNOWN,
            power_supply_technology=BatteryState.POWER_SUPPLY_TECHNOLOGY_UNKNOWN,
            present=True,
            location=self._stream.identity.label,
            serial_number=self._stream.identity.unit,
        )


class ImuWriter(StandardMessageWriter):
    """``<data>_imu``: orientation and acceleration of a motion sensor.

    Nothing says which way the device's world frame points, so neither is turned: see
    the sensor's page.
    """

    message_class = Imu

    @classmethod
    def topic_of(cls, header: StreamHeader) -> str:
        """See :meth:`StandardMessageWriter.topic_of`."""
        return standard_topics.imu(header)

    def build(self, header: Header, sample: Sequence[float]) -> Imu:
        """Make a message; acceleration in m/s², no angular velocity."""
        w, x, y, z = self._values(sample, ORIENTATION)
        is_known = not math.isnan(x + y + z + w)
        orientation = Quaternion(x=x, y=y, z=z, w=w) if is_known else Quaternion()
        in_g = self._values(sample, ACCELERATION)
        has_acceleration = not any(map(math.isnan, in_g))
        return Imu(
            header=header,
            orientation=orientation,
            orientation_covariance=_UNKNOWN if is_known else _MISSING,
            angular_velocity_covariance=_MISSING,
            linear_acceleration=_vector(in_g, STANDARD_GRAVITY) if has_acceleration else Vector3(),
            linear_acceleration_covariance=_UNKNOWN if has_acceleration else _MISSING,
        )


class MagneticFieldWriter(StandardMessageWriter):
    """``<data>_mag``."""

    message_class = MagneticField

    @classmethod
    def topic_of(cls, header: StreamHeader) -> str:
        """See :meth:`StandardMessageWriter.topic_of`."""
        return standard_topics.magnetic_field(header)

    def build(self, header: Header, sample: Sequence[float]) -> MagneticField:
        """Make a message in tesla."""
        return MagneticField(
            header=header,
            magnetic_field=_vector(self._values(sample, MAGNETIC_FIELD), 1e-6),
            magnetic_field_covariance=_UNKNOWN,
        )


STANDARD_MESSAGES: tuple[type[StandardMessageWriter], ...] = (
    TemperatureWriter,
    BatteryStateWriter,
    ImuWriter,
    MagneticFieldWriter,
)


def _vector(values: Sequence[float], scale: float) -> Vector3:
    x, y, z = (scale * value for value in values)
    return Vector3(x=x, y=y, z=z)


def _float32(value: float) -> float:
    with np.errstate(over="ignore"):
        return float(np.float32(value))
