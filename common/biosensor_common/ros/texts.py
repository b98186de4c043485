"""Serialises text streams as raw and stamped messages, and an agent's counters."""

from __future__ import annotations

import struct

from biosensor_common.quantities import MessageType
from biosensor_common.ros.cdr import ENCAPSULATION, aligned, stamp, text
from biosensor_common.topic_text import read_counters

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
