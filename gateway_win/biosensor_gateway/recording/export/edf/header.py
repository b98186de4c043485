"""Makes the header of a BDF+ file.

edfio writes whole files that are in memory. Here it makes a file of one record, of which only
the header is taken, with the number of records that will follow.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime

import numpy as np
from edfio import Bdf, BdfSignal, EdfAnnotation, Patient, Recording

from biosensor_gateway.recording.export.edf.layout import GREATEST, LEAST, Channel, Layout
from biosensor_gateway.recording.export.edf.records import BYTES_PER_SAMPLE

_RECORDS_AT = 236
_FIELD = 8
# Label, transducer and dimension come before the ranges, those and the filter before the samples.
_BEFORE_RANGES = 16 + 80 + 8
_BEFORE_SAMPLES = _BEFORE_RANGES + 4 * _FIELD + 80
_FIXED = 256
_NOT_PLAIN = re.compile(r"[^!-~]+")
_MOST_CODE = 24


@dataclass(frozen=True, slots=True)
class Facts:
    """What the header tells of the recording.

    Attributes
    ----------
    participant, equipment
        Empty if not known.
    begun_ns
        Unix time of the first sample; None if the file is to tell no time of day.
    """

    participant: str
    equipment: str
    begun_ns: int | None

    @property
    def start_s(self) -> float:
        """Time of the first sample since the whole second that the header tells."""
        return 0.0 if self.begun_ns is None else self.begun_ns % 1_000_000_000 / 1e9


def header(
    channels: Sequence[Channel], layout: Layout, facts: Facts, annotation_bytes: int
) -> bytes:
    """Return the bytes before the data records."""
    signals = [
        BdfSignal(
            np.full(layout.samples, each.least),
            layout.rate_hz,
            label=each.label,
            physical_dimension=each.dimension,
            physical_range=(each.least, each.greatest),
            digital_range=(LEAST, GREATEST),
        )
        for each in channels
    ]
    begun = None
    if facts.begun_ns is not None:
        begun = datetime.fromtimestamp(facts.begun_ns // 1_000_000_000, UTC)
    made = Bdf(
        signals,
        patient=Patient(code=_code(facts.participant)),
        recording=Recording(
            startdate=begun.date() if begun else None, equipment_code=_code(facts.equipment)
        ),
        starttime=begun.time() if begun else None,
        data_record_duration=layout.record_s,
        annotations=[EdfAnnotation(0, None, "begin")],
    )
    content = bytearray(made.to_bytes()[: made.bytes_in_header_record])
    _put(content, _RECORDS_AT, layout.records)
    # The annotations are the last signal.
    count = len(channels) + 1
    place = _FIXED + count * _BEFORE_SAMPLES + (count - 1) * _FIELD
    _put(content, place, annotation_bytes // BYTES_PER_SAMPLE)
    # edfio rounds them once more.
    place = _FIXED + count * _BEFORE_RANGES
    for number, each in enumerate(channels):
        _put(content, place + number * _FIELD, each.least)
        _put(content, place + (count + number) * _FIELD, each.greatest)
    return bytes(content)


def _put(content: bytearray, place: int, number: float) -> None:
    text = f"{number:.6f}".rstrip("0").rstrip(".")
    content[place : place + _FIELD] = text.encode().ljust(_FIELD)


def _code(text: str) -> str:
    return _NOT_PLAIN.sub("_", text)[:_MOST_CODE] or "X"
