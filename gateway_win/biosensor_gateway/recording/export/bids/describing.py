"""Tells of the whole dataset: its description, its participants, what to know before using it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from importlib.metadata import version
from pathlib import Path

from biosensor_gateway.recording.export.bids.signals import Remarks
from biosensor_gateway.recording.export.bids.subjects import SHARED, UNKNOWN, Subjects
from biosensor_gateway.recording.export.bids.tables import write_json, write_rows, write_text
from biosensor_gateway.recording.export.exporter import Missing

BIDS_VERSION = "1.11.1"
"""The newest that the validator knows."""

_MOST_NAMES = 5
_README = f"""\
# {{name}}

Made from one recording of LSL streams (XDF) by biosensor-gateway {{version}}. Please complete
this text, and name authors and licence in dataset_description.json, before you share it.

- beh/*_physio: signals with a rate. The table has equal steps of 1/SamplingFrequency from
  StartTime on. Every sample stands in the row that is nearest to its time, and the column
  timestamp has the time itself. Nothing was interpolated or left out: where a sample is missing,
  the row is n/a. SamplingFrequency is the real rate between gaps; SamplingFrequencyNominal is
  what the device promised. LargestDisplacement says, in s, how far a sample is from its row at
  most, and SamplesInAnotherRow how many did not find their own row free.
- motion/*_motion: the same of accelerometers and the like. There SamplingFrequency is the nominal
  rate and SamplingFrequencyEffective the real one, as BIDS wants it.
- beh/*_physioevents: signals without a rate, such as beats; onset is their time. OnsetSource is
  empty because they have no table of equal steps beside them.
- beh/*_events.tsv: markers, and what happened to the devices. Rows that are undone were taken back.

All times are in s since TimeZero, which every sidecar names; it is the same for all people.
sub-{UNKNOWN} stands for somebody whom the recording does not name, sub-{SHARED} for streams that
belong to none of several people.
"""


def describe(root: Path, name: str, subjects: Subjects, written: set[str]) -> None:
    """Write what a dataset needs beside its tables.

    Parameters
    ----------
    name
        Of the recording.
    written
        Labels of those who have a folder.

    Raises
    ------
    OSError
        If it cannot be written.
    """
    gateway = version("biosensor-gateway")
    description = {
        "Name": name,
        "BIDSVersion": BIDS_VERSION,
        "DatasetType": "raw",
        "GeneratedBy": [{"Name": "biosensor-gateway", "Version": gateway}],
    }
    write_json(root / "dataset_description.json", description)
    write_text(root / "README.md", _README.format(name=name, version=gateway))
    rows = [
        (f"sub-{label}", called)
        for label, called in subjects.participants.items()
        if label in written
    ]
    write_rows(root / "participants.tsv", [("participant_id", "recorded_as"), *rows])
    told = {"recorded_as": {"Description": "what the headers of the streams call this person"}}
    write_json(root / "participants.json", told)


def sentences(remarks: Remarks, subjects: Subjects) -> Iterator[str]:
    """Give what a person should know at once."""
    if subjects.participants.get(UNKNOWN) == "":
        yield f"no stream names a participant: all is in sub-{UNKNOWN}"
    elif subjects.participants.get(subjects.nobodys) == "":
        yield f"streams that name nobody are in sub-{subjects.nobodys}; markers hold for everybody"
    if remarks.without_samples:
        yield f"no samples, so no table: {_listed(remarks.without_samples)}"
    if remarks.without_table:
        yield Missing(
            "stamps far from any rate, so no table of equal steps; "
            f"csv has them: {_listed(remarks.without_table)}"
        )
    if remarks.cut:
        yield (
            "cut into several tables, where a gap is longer than an hour or time steps back: "
            f"{_listed(remarks.cut)}"
        )
    if remarks.moved:
        yield (
            "some samples are not in the row of their time, as it was taken; the column "
            f"timestamp has the time, the sidecar how many and how far: {_listed(remarks.moved)}"
        )
    if remarks.unplaced:
        yield f"{remarks.unplaced} samples have stamps of no clock and were left out"


def _listed(names: Sequence[str]) -> str:
    rest = f" and {len(names) - _MOST_NAMES} more" if len(names) > _MOST_NAMES else ""
    return ", ".join(names[:_MOST_NAMES]) + rest
