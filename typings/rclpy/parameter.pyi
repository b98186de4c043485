from enum import Enum
from typing import Any

from rcl_interfaces.msg import Parameter as ParameterMessage

class Parameter:
    class Type(Enum):
        NOT_SET = 0
        BOOL = 1
        INTEGER = 2
        DOUBLE = 3
        STRING = 4

    def __init__(self, name: str, type_: Type | None = ..., value: Any = ...) -> None: ...
    @property
    def name(self) -> str: ...
    @property
    def value(self) -> Any: ...
    def to_parameter_msg(self) -> ParameterMessage: ...
    @classmethod
    def from_parameter_msg(cls, param_msg: ParameterMessage) -> Parameter: ...
