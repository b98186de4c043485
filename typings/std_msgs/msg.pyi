from array import array
from collections.abc import Sequence

from builtin_interfaces.msg import Time

class Header:
    stamp: Time
    frame_id: str
    def __init__(self, *, stamp: Time = ..., frame_id: str = ...) -> None: ...

class MultiArrayDimension:
    label: str
    size: int
    stride: int
    def __init__(self, *, label: str = ..., size: int = ..., stride: int = ...) -> None: ...

class MultiArrayLayout:
    dim: Sequence[MultiArrayDimension]
    data_offset: int
    def __init__(
        self, *, dim: Sequence[MultiArrayDimension] = ..., data_offset: int = ...
    ) -> None: ...

class _FloatArray:
    layout: MultiArrayLayout
    data: array[float]
    def __init__(self, *, layout: MultiArrayLayout = ..., data: array[float] = ...) -> None: ...

class Float32MultiArray(_FloatArray): ...
class Float64MultiArray(_FloatArray): ...

class _IntArray:
    layout: MultiArrayLayout
    data: array[int]
    def __init__(self, *, layout: MultiArrayLayout = ..., data: array[int] = ...) -> None: ...

class Int32MultiArray(_IntArray): ...
class Int64MultiArray(_IntArray): ...

class Int32:
    data: int
    def __init__(self, *, data: int = ...) -> None: ...

class Empty:
    def __init__(self) -> None: ...

class Float32:
    data: float
    def __init__(self, *, data: float = ...) -> None: ...

class Float64:
    data: float
    def __init__(self, *, data: float = ...) -> None: ...

class String:
    data: str
    def __init__(self, *, data: str = ...) -> None: ...

class UInt8:
    data: int
    def __init__(self, *, data: int = ...) -> None: ...

class UInt16:
    data: int
    def __init__(self, *, data: int = ...) -> None: ...
