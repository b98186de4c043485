from typing import Any

class SetParameters:
    class Request:
        parameters: list[Any]
        def __init__(self, *, parameters: list[Any] = ...) -> None: ...
