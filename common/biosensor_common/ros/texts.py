"""Decodes text samples and an agent's counters, and serialises them as raw and stamped messages."""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Iterator, Mapping
from typing import Any, Protocol

from biosensor_common.quantities import MessageType
from biosensor_common.ros.cdr import ENCAPSULATION, aligned, stamp, text

_CLOCK = "clock_"
CLOCK_FACTS = ("offset_s", "drift_ppm", "residual_rms_s", "reanchors")
"""Facts of a device's clock in an agent's counters, see `.device_clock.ClockState`."""


class Sample(Protocol):
    """Values of one sample, one per channel: a tuple, a list or an array."""

    def __len__(self) -> int: ...
    def __getitem__(self, channel: int, /) -> str | float: ...
    def __iter__(self) -> Iterator[Any]: ...


def text_of(sample: Sample) -> str:
    """Return a text sample as one string; several channels become a JSON list."""
    # JSON separates them, whatever characters they contain.
    return str(sample[0]) if len(sample) == 1 else json.dumps(list(sample))


def read_counters(text: str) -> dict[str, dict[str, float]]:
    """Parse one sample of the agent's counters stream: counters by source_id.

    One stream's entry per device also has the state of the device's clock, as ``clock_``
    followed by a name of `CLOCK_FACTS`.

    Raises
    ------
    ValueError
        If it is not in an agent's format.
    """
    try:
        return {str(source_id): _numbers(entry) for source_id, entry in json.loads(text).items()}
    except (AttributeError, KeyError, OverflowError, RecursionError, TypeError) as error:
        raise ValueError("not the counters of an agent") from error


def clock_of(counters: Mapping[str, float]) -> dict[str, float]:
    """Return the state of a device's clock, by `CLOCK_FACTS`, from one entry of the counters."""
    told = ((key, counters.get(f"{_CLOCK}{key}")) for key in CLOCK_FACTS)
    return {key: value for key, value in told if value is not None}


def _numbers(entry: Any) -> dict[str, float]:  # noqa: ANN401 - whatever JSON holds
    counters = {key: _finite(entry[key]) for key in ("pushed", "lost", "last_stamp")}
    clock = entry.get("clock", {})
    return counters | {f"{_CLOCK}{key}": _finite(clock[key]) for key in CLOCK_FACTS if key in clock}


def _finite(number: Any) -> float:  # noqa: ANN401 - whatever JSON holds
    value = float(number)
    if not math.isfinite(value):
        raise ValueError(f"{number} is no counter")
    return value


_SEQUENCE = struct.Struct("<Q")
# A message without fields still has one byte, padded to an aligned end.
_EMPTY = ENCAPSULATION + bytes(4)
_OK = b"\0"
_NO_TEXT = text("")


def raw_text(message_type: MessageType, value: str) -> bytes:
    """Serialise a ``std_msgs/String``, or an ``Empty`` without the text."""
    return _EMPTY if message_type is MessageType.EMPTY else ENCAPSULATION + text(value)


class StampedTexts:
    """``biosensor_msgs/Event``: one message per sample."""

    def __init__(self, frame_id: str) -> None:
        self._frame = aligned(text(frame_id), 8)

    def encode(self, unix_ns: int, value: str, sequence: int) -> bytes:
        """Serialise one sample."""
        head = ENCAPSULATION + stamp(unix_ns) + self._frame
        return head + _SEQUENCE.pack(sequence) + text(value)


def counters_message(unix_ns: int, value: str) -> bytes:
    """Serialise one sample of the agent's counters as ``diagnostic_msgs/DiagnosticArray``.

    Raises
    ------
    ValueError
        If it is not in an agent's format.
    """
    content = bytearray(aligned(stamp(unix_ns) + _NO_TEXT, 4))
    counters = read_counters(value)
    content += len(counters).to_bytes(4, "little")
    for source_id, values in counters.items():
        content += _OK
        for part in (source_id, "", ""):
            _append(content, text(part))
        _append(content, len(values).to_bytes(4, "little"))
        for key, number in values.items():
            _append(content, text(key))
            _append(content, text(str(number)))
    return ENCAPSULATION + bytes(content)


def _append(content: bytearray, part: bytes) -> None:
    content += bytes(-len(content) % 4)
    content += part
