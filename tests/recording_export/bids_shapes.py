"""Recordings of all shapes that a BIDS dataset is made of, and its tables read back."""

from __future__ import annotations

import gzip
import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
from numpy.typing import NDArray

from biosensor_common.naming import lsl_name, source_id
from biosensor_common.spec import DeviceIdentity
from tests.xdf import xdf_file as made

# Recordings of all shapes that a BIDS dataset is made of.

BEGIN_S = 100.0
_AT_ONCE = 50


def numbers(rows: int, channels: int = 1, seed: int = 0) -> NDArray[np.float32]:
    """Values as a converter gives them and as a filter does, and NaN, which is no value."""
    random = np.random.default_rng(seed)
    values = random.normal(0, 300, (rows, channels)).astype(np.float32)
    values[::3] = np.round(values[::3]) * np.float32(0.1)
    values[5::97] = np.nan
    return values


def times(count: int, rate_hz: float, begin_s: float = BEGIN_S) -> NDArray[np.float64]:
    return begin_s + np.arange(count) / rate_hz


def stream(
    number: int,
    name: str,
    values: Sequence[Sequence[Any]] | NDArray[Any],
    stamps: Iterable[float],
    *,
    offsets: bool = True,
    **header: Any,
) -> bytes:
    """A stream of any kind, as the part of a file."""
    rows = values.tolist() if isinstance(values, np.ndarray) else values
    at = list(stamps)
    header = {"fmt": "float32", "channels": len(rows[0]) if rows else 1, **header}
    parts = [made.stream_header(number, name, **header)]
    for begin in range(0, len(at), _AT_ONCE):
        end = begin + _AT_ONCE
        parts.append(made.samples(number, header["fmt"], rows[begin:end], at[begin:end]))
    if offsets and at:
        parts.append(made.offsets(number, (at[0], at[-1])))
    return b"".join(parts)


def ours(
    number: int,
    identity: DeviceIdentity,
    data_name: str,
    values: Sequence[Sequence[Any]] | NDArray[Any],
    stamps: Iterable[float],
    channels: Sequence[tuple[str, str]] = (("value", "microvolts"),),
    **header: Any,
) -> bytes:
    """A stream as the agent sends it; `channels` are labels and units."""
    is_text = header.get("fmt") == "string"
    return stream(
        number,
        lsl_name(identity, data_name),
        values,
        stamps,
        source_id=source_id(identity, data_name),
        desc=_description(identity, data_name, channels, is_text=is_text),
        **header,
    )


def _description(
    identity: DeviceIdentity,
    data_name: str,
    channels: Sequence[tuple[str, str]],
    *,
    is_text: bool,
) -> ET.Element:
    desc = ET.Element("desc")
    listed = ET.SubElement(desc, "channels")
    for label, unit in channels:
        channel = ET.SubElement(listed, "channel")
        ET.SubElement(channel, "label").text = label
        ET.SubElement(channel, "unit").text = unit
    acquisition = ET.SubElement(desc, "acquisition")
    ET.SubElement(acquisition, "manufacturer").text = "Acme"
    ET.SubElement(acquisition, "model").text = identity.sensor.upper()
    ET.SubElement(acquisition, "serial_number").text = identity.unit
    block = ET.SubElement(desc, "biosensor")
    for name, text in {
        "version": "1",
        "sensor": identity.sensor,
        "unit": identity.unit,
        "participant": identity.participant,
        "label": identity.label,
        "data_name": data_name,
        "category": "raw",
        "message_type": "std_msgs/msg/" + ("String" if is_text else "Float32MultiArray"),
        "chunk": "",
        "is_state": "false",
    }.items():
        ET.SubElement(block, name).text = text
    return desc


def marker(number: int, name: str, at: float, **more: Any) -> list[str]:
    """A marker as the agent sends it."""
    return [json.dumps({"marker": name, "kind": "api", "id": number, "lsl_time": at, **more})]


def h10(first: int, who: str, unit: str = "A1", label: str = "") -> bytes:
    """A strap: ECG with a gap, acceleration, beats."""
    strap = DeviceIdentity("polar_h10", unit, who, label)
    ecg = np.delete(times(1000, 130.0), slice(300, 340))
    axes = [(axis, "g") for axis in "XYZ"]
    beats = times(9, 1.25)
    return b"".join(
        [
            ours(first, strap, "ecg", numbers(960), ecg, [("ECG", "microvolts")], rate=130.0,
                 kind="ECG"),
            ours(first + 1, strap, "acc", numbers(300, 3), times(300, 50.0), axes, rate=50.0,
                 kind="Accelerometer"),
            ours(first + 2, strap, "ibi", numbers(9), beats, [("RR", "s")], kind="RR"),
        ]
    )  # fmt: skip


def _markers(number: int) -> bytes:
    agent = DeviceIdentity("gateway", "lab-pc")
    texts = [
        marker(1, "baseline", 101.0),
        marker(2, "stimulus\ton", 102.0),
        marker(3, "note", 103.0, note="Übelkeit?"),
        marker(4, "undo", 104.0, of=2),
    ]
    stamps = [101.0, 102.0, 103.0, 104.0]
    return ours(number, agent, "markers", texts, stamps, [("marker", "none")], fmt="string",
                kind="Markers")  # fmt: skip


def _foreign() -> bytes:
    jitter = np.random.default_rng(3).exponential(0.01, 2000)
    texts = [[f"trial {n}", "left"] for n in range(4)]
    return b"".join(
        [
            stream(1, "BrainAmp 0-1", numbers(2000, 4), times(2000, 500.0) + jitter, rate=500.0,
                   kind="EEG", offsets=False),
            stream(2, "PsychoPy", texts, times(4, 1.0), fmt="string", kind="Markers"),
            stream(3, "Tobii: blink", [(n,) for n in range(5)], times(5, 2.0), fmt="int32"),
            stream(4, "keys", [(n,) for n in range(5)], times(5, 2.0), fmt="int16",
                   kind="Markers"),
            stream(5, "rigid body", numbers(200, 7), times(200, 100.0), rate=100.0, kind="MoCap"),
            stream(6, "empty", [], [], rate=10.0),
        ]
    )  # fmt: skip


EEG_VALUES = np.random.default_rng(7).normal(0, 30, (5000, 2)).astype(np.float32)
"""Of `eeg`, in microvolts."""


def eeg(fmt: str = "float32") -> bytes:
    """EEG of 250 Hz with gaps of 2 and 28 s behind 8 and 18 s, and markers everywhere."""
    stamps = times(5000, 250.0)
    stamps[2000:] += 2.0
    stamps[4000:] += 28.0
    channels = "".join(
        f"<channel><label>{each}</label><unit>microvolts</unit><type>EEG</type></channel>"
        for each in ("Fz", "Cz")
    )
    desc = ET.fromstring(f"<desc><channels>{channels}</channels></desc>")
    values = EEG_VALUES.astype("int16") if fmt == "int16" else EEG_VALUES
    amplifier = stream(
        1, "amp", values, stamps, rate=250.0, kind="EEG", fmt=fmt, desc=desc, source_id="amp"
    )
    told = [["before"], ["a"], ["b, c"], ["between"], ["after"]]
    moments = [BEGIN_S + each for each in (-5.0, 1.0, 9.0, 30.0, 60.0)]
    return made.xdf(amplifier, stream(2, "marks", told, moments, fmt="string", kind="markers"))


EMG_VALUES = np.random.default_rng(8).normal(0, 0.2, (6000, 2)).astype(np.float32)
"""Of `muscles_and_eyes`, in millivolts, at 512 Hz, with a gap of 2 s behind 3000."""
GAZE_VALUES = np.random.default_rng(9).random((600, 7)).astype(np.float32)


def _described(*channels: tuple[str, str, str, str]) -> ET.Element:
    """Labels, units, types and eyes of channels."""
    desc = ET.Element("desc")
    listed = ET.SubElement(desc, "channels")
    for told in channels:
        channel = ET.SubElement(listed, "channel")
        for name, text in zip(("label", "unit", "type", "eye"), told, strict=True):
            ET.SubElement(channel, name).text = text
    return desc


def muscles_and_eyes() -> bytes:
    """EMG of our own and of a bursty stranger, gaze of two eyes and of none that is named."""
    leg = DeviceIdentity("shimmer", "A9", "p01")
    stamps = times(6000, 512.0)
    stamps[3000:] += 2.0
    burst = np.repeat(times(40, 10.0), 50)
    eyes = _described(
        ("left_gaze_x", "px", "ScreenX", "left"),
        ("left_gaze_y", "px", "ScreenY", "left"),
        ("left_pupil", "mm", "Diameter", "left"),
        ("right_gaze_x", "px", "ScreenX", "right"),
        ("right_gaze_y", "px", "ScreenY", "right"),
        ("right_pupil", "mm", "Diameter", "right"),
        ("confidence", "", "Confidence", ""),
    )
    both = _described(("norm_pos_x", "", "", ""), ("norm_pos_y", "", "", ""))
    told = [["go"], ["stop"]]
    return made.xdf(
        ours(1, leg, "emg", EMG_VALUES, stamps, [("EMG1", "millivolts"), ("EMG2", "millivolts")],
             rate=512.0, kind="EMG"),
        stream(2, "armband", numbers(2000, 8), burst, rate=500.0, kind="emg"),
        stream(3, "tracker", GAZE_VALUES, times(600, 60.0), rate=60.0, kind="Gaze", desc=eyes),
        stream(4, "glasses", numbers(600, 2), times(600, 60.0), rate=60.0, kind="Eye-Tracking",
               desc=both),
        stream(5, "marks", told, [BEGIN_S + 1.0, BEGIN_S + 9.0], fmt="string", kind="Markers"),
    )  # fmt: skip


def _far_apart() -> bytes:
    """A pause of two hours, a clock that was set back, a rate that nothing keeps to."""
    paused = np.concatenate([times(200, 50.0), times(200, 50.0, BEGIN_S + 7300.0)])
    back = np.concatenate([times(200, 50.0, 150.0), times(200, 50.0, 120.0)])
    nowhere = BEGIN_S + np.cumsum(np.full(300, 3000.0))
    return b"".join(
        [
            stream(1, "paused", numbers(400), paused, rate=50.0),
            stream(2, "set back", numbers(400), back, rate=50.0),
            stream(3, "nowhere", numbers(300), nowhere, rate=100.0),
        ]
    )


def _irregular_only() -> bytes:
    strap = DeviceIdentity("ble_heart_rate", "B2", "p7")
    return ours(1, strap, "ibi", numbers(9), times(9, 1.1), [("RR", "s")], kind="RR")


SHAPES: dict[str, bytes] = {
    "one person": made.xdf(h10(1, "p01"), _markers(4)),
    "two persons": made.xdf(h10(1, "p01"), h10(4, "p02", "A2"), _markers(7)),
    "two persons and a room": made.xdf(
        h10(1, "p01"),
        h10(4, "p02", "A2"),
        stream(7, "room", numbers(40), times(40, 4.0), rate=4.0, kind="Temperature"),
        _markers(8),
    ),
    "nobody": made.xdf(h10(1, "")),
    "two sensors of a kind": made.xdf(
        h10(1, "p01", "A1"), h10(4, "p01", "A2", "left"), h10(7, "", "A3"), h10(10, "", "A4")
    ),
    "irregular only": made.xdf(_irregular_only()),
    "markers only": made.xdf(_markers(1)),
    "unicode": made.xdf(h10(1, "Jörg"), h10(4, "Jorg", "A2"), h10(7, "李"), h10(10, "王", "ß")),
    "foreign": made.xdf(_foreign()),
    "far apart": made.xdf(_far_apart()),
    "muscles and eyes": muscles_and_eyes(),
}


# Reads tables of a dataset with nothing but the standard library.
@dataclass(frozen=True)
class Table:
    """A table and its sidecar; rows are texts by the name of the column."""

    sidecar: dict[str, Any]
    rows: list[dict[str, str]]

    def of(self, column: str) -> list[str]:
        return [row[column] for row in self.rows]


def find(dataset: Path, pattern: str) -> Path:
    """The only file of that name."""
    (found,) = dataset.rglob(pattern)
    return found


def read(dataset: Path, name: str) -> Table:
    """The only table whose name ends so, without ``.tsv``: ``recording-ecg_physio``."""
    sidecar = json.loads(find(dataset, f"*{name}.json").read_text("utf-8"))
    path = find(dataset, f"*{name}.tsv*")
    data = gzip.decompress(path.read_bytes()) if path.suffix == ".gz" else path.read_bytes()
    lines = [line.split("\t") for line in data.decode().split("\n")[:-1]]
    if "Columns" in sidecar:
        columns = sidecar["Columns"]
    elif name.endswith("_motion"):
        channels = path.with_name(path.name.replace("_motion", "_channels"))
        columns = [line.split("\t")[0] for line in channels.read_text().splitlines()[1:]]
    else:
        columns = lines.pop(0)
    assert {len(line) for line in lines} <= {len(columns)}
    return Table(sidecar, [dict(zip(columns, line, strict=True)) for line in lines])
