from array import array

from std_msgs.msg import Header

class Event:
    header: Header
    sequence: int
    data: str
    def __init__(self, *, header: Header = ..., sequence: int = ..., data: str = ...) -> None: ...

class Samples:
    header: Header
    sequence: int
    lost: int
    lost_is_estimated: bool
    labels: list[str]
    units: list[str]
    offsets_ns: array[int]
    data: array[float]
    integers: array[int]
    def __init__(
        self,
        *,
        header: Header = ...,
        sequence: int = ...,
        lost: int = ...,
        lost_is_estimated: bool = ...,
        labels: list[str] = ...,
        units: list[str] = ...,
        offsets_ns: array[int] = ...,
        data: array[float] = ...,
        integers: array[int] = ...,
    ) -> None: ...
