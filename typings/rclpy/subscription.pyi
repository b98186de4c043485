from typing import Any

class Subscription:
    msg_type: type[Any]
    @property
    def topic_name(self) -> str: ...
    @property
    def handle(self) -> Any: ...
