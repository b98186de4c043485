"""Reads what the settings say of columns: ``acc/x [g]`` is channel x of the stream acc, in g."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import NamedTuple

from biosensor_common.quantities import Unit

USUAL_STREAM = "data"
SKIPPED = "-"

_COLUMN = re.compile(
    r"(?:(?P<stream>[^/\[\]]*)/)?(?P<label>[^/\[\]]+?)[ ]*(?:\[(?P<unit>[^\[\]]+)\])?"
)


class Column(NamedTuple):
    """One column of each line.

    Attributes
    ----------
    stream
        Data name of the stream that it is a channel of.
    label
        Of the channel; `SKIPPED` for a column that nobody needs.
    unit
        Empty where the settings say none.
    """

    stream: str
    label: str
    unit: str

    @property
    def is_skipped(self) -> bool:
        """Whether its values go nowhere."""
        return self.label == SKIPPED


def column(text: str) -> Column:
    """Read ``stream/label [unit]``; stream and unit may be missing.

    Raises
    ------
    ValueError
        It is not of that form; the sentence says so.
    """
    found = _COLUMN.fullmatch(text.strip())
    if found is None:
        raise ValueError("should be LABEL [UNIT] or STREAM/LABEL [UNIT]")
    stream = found["stream"]
    return Column(
        USUAL_STREAM if stream is None else stream.strip(), found["label"], found["unit"] or ""
    )


def streams_of(columns: Iterable[Column], apart: Iterable[str]) -> dict[str, list[int]]:
    """Return the positions of each stream's channels by data name, in their order.

    Parameters
    ----------
    columns
        Of a line.
    apart
        Labels of columns that count or tell the time.
    """
    without = {SKIPPED, *apart}
    streams: dict[str, list[int]] = {}
    for position, each in enumerate(columns):
        if each.label not in without:
            streams.setdefault(each.stream, []).append(position)
    return streams


def unit_of(each: Column) -> str:
    """Return the unit of a channel."""
    return each.unit or Unit.NONE
