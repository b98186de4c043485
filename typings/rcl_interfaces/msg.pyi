from collections.abc import Sequence
from typing import Any

class IntegerRange:
    def __init__(self, *, from_value: int = ..., to_value: int = ..., step: int = ...) -> None: ...

class FloatingPointRange:
    def __init__(
        self, *, from_value: float = ..., to_value: float = ..., step: float = ...
    ) -> None: ...

class ParameterDescriptor:
    description: str
    def __init__(
        self,
        *,
        name: str = ...,
        type: int = ...,
        description: str = ...,
        read_only: bool = ...,
        dynamic_typing: bool = ...,
        floating_point_range: Sequence[FloatingPointRange] = ...,
        integer_range: Sequence[IntegerRange] = ...,
    ) -> None: ...

class ParameterType:
    PARAMETER_NOT_SET: int
    PARAMETER_STRING_ARRAY: int
    PARAMETER_STRING: int
    PARAMETER_BOOL: int
    PARAMETER_INTEGER: int
    PARAMETER_DOUBLE: int

class Parameter:
    name: str
    value: Any

class SetParametersResult:
    successful: bool
    reason: str
    def __init__(self, *, successful: bool = ..., reason: str = ...) -> None: ...
