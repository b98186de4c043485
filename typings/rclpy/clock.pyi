from enum import IntEnum

from builtin_interfaces.msg import Time as TimeMessage

class Time:
    @property
    def nanoseconds(self) -> int: ...
    def to_msg(self) -> TimeMessage: ...

class ClockType(IntEnum):
    ROS_TIME = 1
    SYSTEM_TIME = 2
    STEADY_TIME = 3

class Clock:
    def __init__(self, *, clock_type: ClockType = ...) -> None: ...
    def now(self) -> Time: ...
    @property
    def ros_time_is_active(self) -> bool: ...
