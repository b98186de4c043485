"""Takes out of a message of the other computer what has the right type and size."""

from __future__ import annotations

import math
from collections.abc import Sequence
from ipaddress import IPv4Address
from typing import Any, cast

from biosensor_common.errors import ProtocolError, ProtocolReason

MAX_TEXT = 256
MAX_TEST_PORTS = 8


class Reader:
    """The fields of one message; every method raises `ProtocolError` with ``GARBAGE``."""

    def __init__(self, message: object) -> None:
        if not isinstance(message, dict):
            raise _wrong("a message", "an object")
        self._fields = cast("dict[str, Any]", message)

    def value(self, name: str) -> object:
        """Return what stands there, unread; None if nothing does."""
        return self._fields.get(name)

    def inner(self, name: str) -> Reader:
        """Return a message within this one."""
        return Reader(self.value(name))

    def text(self, name: str) -> str:
        """Return a text of at most `MAX_TEXT` characters."""
        return _text(name, self.value(name))

    def texts(self, name: str, most: int) -> list[str]:
        """Return a list of texts."""
        return [_text(name, each) for each in entries(self.value(name), most)]

    def one_of(self, name: str, known: Sequence[str]) -> str:
        """Return one of several words."""
        found = self.text(name)
        if found not in known:
            raise _wrong(name, f"one of {', '.join(known)}")
        return found

    def address(self, name: str) -> str:
        """Return an IPv4 address."""
        try:
            return str(IPv4Address(self.text(name)))
        except ValueError as error:
            raise _wrong(name, "an IPv4 address") from error

    def flag(self, name: str) -> bool:
        """Return yes or no."""
        found = self.value(name)
        if not isinstance(found, bool):
            raise _wrong(name, "true or false")
        return found

    def flag_or_none(self, name: str) -> bool | None:
        """Return yes, no, or that nobody knows."""
        return None if self.value(name) is None else self.flag(name)

    def number(self, name: str, least: int, most: int) -> int:
        """Return a whole number within limits, both of them included."""
        return _number(name, self.value(name), least, most)

    def port(self, name: str) -> int:
        """Return a port of TCP or UDP that needs no administrator."""
        return self.number(name, 1024, 65535)

    def ports(self, name: str) -> list[int]:
        """Return a few ports."""
        found = entries(self.value(name), MAX_TEST_PORTS)
        return [_number(name, each, 1024, 65535) for each in found]

    def flags_by_port(self, name: str) -> dict[int, bool]:
        """Return yes or no for a few ports, which JSON has as text."""
        inner = self.inner(name)
        named = entries(list(inner._fields), MAX_TEST_PORTS)
        if not all(isinstance(each, str) and each.isdecimal() for each in named):
            raise _wrong(name, "ports")
        return {int(each): inner.flag(str(each)) for each in cast("list[str]", named)}

    def real_or_none(self, name: str) -> float | None:
        """Return a finite number, or that there is none."""
        found = self.value(name)
        if found is None:
            return None
        if isinstance(found, bool) or not isinstance(found, int | float):
            raise _wrong(name, "a number")
        if not math.isfinite(found):
            raise _wrong(name, "a finite number")
        return float(found)


def entries(found: object, most: int) -> list[object]:
    """Return a list of at most so many entries."""
    if not isinstance(found, list):
        raise _wrong("an entry", "a list")
    several = cast("list[object]", found)
    if len(several) > most:
        raise _wrong("a list", f"of at most {most} entries")
    return several


def _text(name: str, found: object) -> str:
    if not isinstance(found, str) or len(found) > MAX_TEXT:
        raise _wrong(name, f"a text of at most {MAX_TEXT} characters")
    return found


def _number(name: str, found: object, least: int, most: int) -> int:
    if isinstance(found, bool) or not isinstance(found, int) or not least <= found <= most:
        raise _wrong(name, f"a number from {least} to {most}")
    return found


def _wrong(name: str, what: str) -> ProtocolError:
    return ProtocolError(
        ProtocolReason.GARBAGE,
        f"the other computer sent {name} that is not {what}; install the same Biosensor Gateway "
        "on both",
    )
