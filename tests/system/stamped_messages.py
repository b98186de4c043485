"""Messages of `biosensor_msgs` as plain data, taken apart into samples."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

from tests.system.lsl_time import NS_PER_S


class Sample(NamedTuple):
    """A sample as it was received.

    Attributes
    ----------
    values
        One a channel; of an event its text alone.
    """

    sequence: int
    time_ns: int
    values: tuple[Any, ...]


def samples_of(messages: Iterable[Mapping[str, Any]]) -> list[Sample]:
    """Return all samples of ``Samples`` and ``Event`` messages.

    Raises
    ------
    AssertionError
        If a message's values do not fit its number of samples and channels.
    """
    return [sample for message in messages for sample in _samples(message)]


def _samples(message: Mapping[str, Any]) -> list[Sample]:
    stamp, sequence = message["header"]["stamp"], message["sequence"]
    start_ns = stamp["sec"] * NS_PER_S + stamp["nanosec"]
    if isinstance(message["data"], str):
        return [Sample(sequence, start_ns, (message["data"],))]
    offsets, channels = message["offsets_ns"], len(message["labels"])
    # A stream of 64-bit integers has no data, any other has no integers.
    values = message["data"] or message["integers"]
    assert len(values) == len(message["data"]) + len(message["integers"])
    assert len(values) == len(offsets) * channels
    assert offsets[0] == 0
    return [
        Sample(
            sequence + row,
            start_ns + offset,
            tuple(values[row * channels : (row + 1) * channels]),
        )
        for row, offset in enumerate(offsets)
    ]
