"""A bag of MCAP or SQLite, from its bytes to the recording that is made of it.

It is imported, or refused with a BagError. What is written is whole, every sample that is told
is in it, and each message that is missing is told.
"""

from __future__ import annotations

import os

from biosensor_gateway.recording.bag.conversion import import_bag, usual_path
from biosensor_gateway.recording.bag.types import BagError
from biosensor_gateway.recording.xdf.recording import read_recording
from tests.fuzz.contract import ensure
from tests.fuzz.scratch import written

_SQLITE = b"SQLite format 3"
# Packed chunks hold a thousand times their size, which is no find.
_PACKED = (b"zstd", b"lz4")


def check(data: bytes) -> None:
    """Import the bag as ``bag import`` does."""
    if any(name in data for name in _PACKED):
        return
    bag = written("study.db3" if data.startswith(_SQLITE) else "study.mcap", data)
    target = usual_path(bag)
    target.unlink(missing_ok=True)
    try:
        imported = import_bag(bag, target)
    except BagError as error:
        ensure(str(error) != "", "a refusal without a reason", error)
        ensure(not os.path.lexists(target), "a file of a bag that was refused", error)
        return
    recording = read_recording(target)
    ensure(not recording.damages, "what was written is damaged", recording.damages)
    counts = [stream.sample_count for stream in recording.streams]
    ensure(counts == [count for _, count in imported.streams], "other samples were written")
    for stream in recording.streams:
        footer = stream.footer
        ensure(footer is not None, "a stream without a footer")
        told = footer.sample_count if footer else None
        ensure(told == stream.sample_count, "a wrong footer", told)
