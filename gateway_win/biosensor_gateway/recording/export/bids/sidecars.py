"""Creates the JSON sidecars, which describe the columns of a table and their origin."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from biosensor_common.errors import SpecError
from biosensor_common.quantities import Unit
from biosensor_gateway.recording.contents.stream import Stream
from biosensor_gateway.recording.export import tables
from biosensor_gateway.recording.export.bids.regular import RegularTable
from biosensor_gateway.recording.export.exporter import Timeline
from biosensor_gateway.recording.export.time_axis import Timing

TIMESTAMP = "timestamp"
ONSET = "onset"
DURATION = "duration"
_OWN = frozenset({TIMESTAMP, ONSET, DURATION, "trial_type", "message"})

# Units as in the appendix of BIDS; all others already have that form, or there is none.
_UNITS: Mapping[str, str] = {
    Unit.CELSIUS: "oC",
    Unit.MICROSIEMENS: "uS",
    Unit.MICROVOLTS: "uV",
    Unit.MILLIVOLTS: "mV",
    Unit.NEWTONS: "N",
    Unit.NONE: "",
    Unit.PERCENT: "%",
}
_NOT_SAID: Mapping[str, str] = {
    Unit.G: "in standard gravity, 1 g = 9.80665 m/s^2",
    Unit.COUNTS: "counts of the device's converter, without a physical unit",
}
_HARDWARE = {
    "Manufacturer": "manufacturer",
    "ManufacturersModelName": "model",
    "DeviceSerialNumber": "serial_number",
    "SoftwareVersions": "firmware_version",
}


def unit(name: str) -> str:
    """Return a unit in BIDS notation; empty if there is none."""
    return _UNITS.get(name, name)


def columns(stream: Stream) -> list[str]:
    """Return a column name for each channel that differs from the sidecar's keys."""
    labels = tables.columns(stream)
    if labels == ["1"]:
        labels = [stream.meaning.data_name]
    # Keys begin with a capital letter, as most labels do, so they could clash.
    taken = {*_OWN, *_KEYS}
    return tables.unique(
        f"channel_{each}" if each in taken or each.isdigit() else "_".join(each.split())
        for each in labels
    )


def described_columns(stream: Stream) -> dict[str, dict[str, str]]:
    """Return the description of each column by name."""
    found: dict[str, dict[str, str]] = {}
    told = zip(columns(stream), stream.header.labels, stream.meaning.units, strict=True)
    for name, label, unit_name in told:
        facts = {"Description": f"{label} of {stream.header.title}"}
        if unit_name in _NOT_SAID:
            facts["Description"] += f", {_NOT_SAID[unit_name]}"
        if unit(unit_name):
            facts["Units"] = unit(unit_name)
        found[name] = facts
    return found


def of_stream(stream: Stream, timeline: Timeline) -> dict[str, object]:
    """Return the entries common to all tables of a stream: device, source, time zero."""
    header = stream.header
    return {
        **hardware(stream),
        **timeline.described(),
        "LslStream": {
            "Name": header.name,
            "Type": header.content_type,
            "SourceId": header.source_id,
            "Format": header.format.value,
            "ClockMeasured": stream.clock.is_known,
        },
    }


def of_grid(stream: Stream, timing: Timing, table: RegularTable) -> dict[str, object]:
    """Return the entries about the rows of a regular table."""
    return {
        "StartTime": round(table.start_s, 6),
        "SamplingFrequencyNominal": stream.header.rate,
        "Samples": table.samples,
        "EmptyRows": table.empty_rows,
        "Gaps": timing.gaps,
        "LongestGap": round(timing.longest_gap_s, 6),
        "LargestDisplacement": round(table.largest_displacement_s, 9),
        "SamplesInAnotherRow": table.moved,
    }


def timestamp() -> dict[str, object]:
    """Return the description of the time column."""
    told = "time of the sample as it was recorded, since TimeZero; its row is the nearest"
    return {TIMESTAMP: {"Description": told, "Units": "s"}}


def hardware(stream: Stream) -> dict[str, str]:
    """Return the header's information about the device, if any."""
    try:
        root = stream.header.parsed()
    except SpecError:
        return {}
    told = {
        key: (root.findtext(f"desc/acquisition/{element}") or "").strip()
        for key, element in _HARDWARE.items()
    }
    return {key: text for key, text in told.items() if text}


def channel_types(stream: Stream) -> Sequence[str]:
    """Return the type of each channel in the header; empty where there is none."""

    def told() -> Iterator[str]:
        for channel in stream.header.parsed().findall("desc/channels/channel"):
            yield (channel.findtext("type") or "").strip()

    count = stream.header.channel_count
    try:
        types = list(told())
    except SpecError:
        types = []
    return types if len(types) == count else [""] * count


_KEYS = frozenset(
    {
        *_HARDWARE,
        "StartTime",
        "SamplingFrequency",
        "SamplingFrequencyEffective",
        "SamplingFrequencyNominal",
        "Samples",
        "EmptyRows",
        "Gaps",
        "LongestGap",
        "LargestDisplacement",
        "SamplesInAnotherRow",
        "TimeZero",
        "LslStream",
        "Columns",
        "PhysioType",
        "TaskName",
        "Description",
        "OnsetSource",
        "MissingValues",
    }
)
