"""Declares a board's streams from BrainFlow's description of it.

`SPEC` is the declaration of BrainFlow's synthetic board, shown in lists and documents.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

from biosensor_common import plausible
from biosensor_common.quantities import ContentType, Unit
from biosensor_common.spec import SensorSpec, StreamSpec
from biosensor_common.table import battery, channels, raw
from biosensor_gateway.devices.sensor import Sensor

NAME = "brainflow"
ELECTRODES = ("eeg", "ecg", "emg", "eog")
"""Possible uses of electrodes; most boards list the same rows for all of them."""
PRESETS: Final = {0: "", 1: "aux", 2: "anc"}
"""Suffix of a stream's name if another preset of the board has the same stream."""

Description = Mapping[str, Any]
"""Description of one preset: ``num_rows``, ``sampling_rate``, ``eeg_channels`` and so on."""


@dataclass(frozen=True, slots=True)
class _Kind:
    """One kind of rows, with the unit documented by BrainFlow, or an arbitrary unit."""

    key: str
    data_name: str
    content_type: ContentType
    unit: str
    plausible: tuple[float, float] | None = None
    labels: tuple[str, ...] = ()


_AXES = ("X", "Y", "Z")
_KINDS = (
    _Kind("eeg_channels", "eeg", ContentType.EEG, Unit.MICROVOLTS, plausible.BIOPOTENTIAL_UV),
    _Kind("ecg_channels", "ecg", ContentType.ECG, Unit.MICROVOLTS, plausible.BIOPOTENTIAL_UV),
    _Kind("emg_channels", "emg", ContentType.EMG, Unit.MICROVOLTS, plausible.BIOPOTENTIAL_UV),
    _Kind("eog_channels", "eog", ContentType.MISC, Unit.MICROVOLTS, plausible.BIOPOTENTIAL_UV),
    _Kind("eda_channels", "gsr", ContentType.GSR, Unit.ARBITRARY),
    _Kind("ppg_channels", "ppg", ContentType.PPG, Unit.ARBITRARY),
    _Kind("optical_channels", "optics", ContentType.MISC, Unit.ARBITRARY),
    _Kind(
        "accel_channels", "acc", ContentType.ACCELEROMETER, Unit.G, plausible.ACCELERATION_G, _AXES
    ),
    _Kind(
        "gyro_channels",
        "gyro",
        ContentType.GYROSCOPE,
        Unit.DEGREES_PER_SECOND,
        plausible.ROTATION_DEG_S,
        _AXES,
    ),
    _Kind("magnetometer_channels", "mag", ContentType.MAGNETOMETER, Unit.ARBITRARY, None, _AXES),
    _Kind("rotation_channels", "rotation", ContentType.MOCAP, Unit.ARBITRARY),
    _Kind(
        "temperature_channels",
        "temp",
        ContentType.TEMPERATURE,
        Unit.CELSIUS,
        plausible.TEMPERATURE_C,
    ),
    _Kind(
        "resistance_channels", "impedance", ContentType.QUALITY, Unit.OHMS, plausible.RESISTANCE_OHM
    ),
    _Kind("analog_channels", "analog", ContentType.MISC, Unit.ARBITRARY),
)
_BATTERY = "battery_channel"


@dataclass(frozen=True, slots=True)
class BoardStream:
    """One stream of a board."""

    spec: StreamSpec
    preset: int  # BrainFlow's number of its preset.
    rows: tuple[int, ...]  # Rows of that preset, one per channel.
    is_state: bool = False  # Whether only changes are sent.


def board_streams(
    described: Mapping[int, Description], electrodes: str = "", rate_hz: float = 0.0
) -> tuple[BoardStream, ...]:
    """Return the streams of a board.

    Parameters
    ----------
    described
        BrainFlow's description by preset.
    electrodes
        Use of the electrodes, one of `ELECTRODES`; empty for the board's first one.
    rate_hz
        Rate of the first preset, if the board was configured to a different one than described.
    """
    streams: list[BoardStream] = []
    for preset, description in sorted(described.items()):
        rate = rate_hz if rate_hz and preset == 0 else float(description.get("sampling_rate", 0))
        taken = {stream.spec.data_name for stream in streams}
        streams += _of_preset(preset, description, rate, electrodes, taken)
    return tuple(streams)


def board_spec(name: str, board: str, streams: Sequence[BoardStream]) -> SensorSpec:
    """Return the declaration of a board.

    Raises
    ------
    SpecError
        ``INVALID``, if a stream's description is invalid.
    """
    return SensorSpec(
        name=name,
        title=f"BrainFlow: {board}",
        manufacturer="",
        model=board,
        streams=tuple(stream.spec for stream in streams),
    )


def _of_preset(
    preset: int, description: Description, rate: float, electrodes: str, taken: set[str]
) -> Iterator[BoardStream]:
    chosen = _electrodes(description, electrodes)
    for kind in _KINDS:
        rows = tuple(description.get(kind.key, ()))
        if rows and (kind.data_name not in ELECTRODES or kind.data_name == chosen):
            name = _free(kind.data_name, preset, taken)
            specs = channels(
                kind.unit, *_labels(kind, len(rows), description), plausible=kind.plausible
            )
            spec = raw(name, kind.content_type, specs, rate, chunk=name if rate else "")
            yield BoardStream(spec, preset, rows)
    if _BATTERY in description:
        name = _free("bat", preset, taken)
        spec = replace(battery(), data_name=name)
        yield BoardStream(spec, preset, (description[_BATTERY],), is_state=True)


def _electrodes(description: Description, wanted: str) -> str:
    has = [kind for kind in ELECTRODES if description.get(f"{kind}_channels")]
    return wanted if wanted in has else (has or [""])[0]


def _free(data_name: str, preset: int, taken: set[str]) -> str:
    suffix = PRESETS.get(preset, str(preset))
    return f"{data_name}_{suffix}" if data_name in taken and suffix else data_name


def _labels(kind: _Kind, count: int, description: Description) -> Sequence[str]:
    if kind.data_name == "eeg":
        names = [each.strip() for each in str(description.get("eeg_names", "")).split(",")]
        if len(names) == count and len(set(names)) == count and all(names):
            return names
    if len(kind.labels) == count:
        return kind.labels
    return [f"{kind.data_name.upper()}{number}" for number in range(1, count + 1)]


SPEC = board_spec(
    NAME,
    "SYNTHETIC_BOARD",
    board_streams(
        {
            0: {
                "sampling_rate": 250,
                "eeg_channels": range(1, 17),
                "eeg_names": "Fz,C3,Cz,C4,Pz,PO7,Oz,PO8,F5,F7,F3,F1,F2,F4,F6,F8",
                "accel_channels": (17, 18, 19),
                "gyro_channels": (20, 21, 22),
                "eda_channels": (23,),
                "ppg_channels": (24, 25),
                "temperature_channels": (26,),
                "resistance_channels": (27, 28),
                "battery_channel": 29,
            }
        }
    ),
)

SENSOR = Sensor(
    SPEC,
    driver="biosensor_gateway.devices.brainflow.driver:DRIVER",
    precedence=-1,
)
