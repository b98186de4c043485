from typing import Any

class GetParameters:
    class Request:
        names: list[str]
        def __init__(self, *, names: list[str] = ...) -> None: ...

    class Response:
        values: list[Any]

class SetParameters:
    class Request:
        parameters: list[Any]
        def __init__(self, *, parameters: list[Any] = ...) -> None: ...
