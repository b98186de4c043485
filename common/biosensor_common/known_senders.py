"""Maps LSL streams of known programs to sensor names.

A stream's own name often makes a poor topic: Pupil Labs' app calls its gaze
``lab phone_Neon Gaze``. Streams that are not in this table keep their own names.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field

from biosensor_common.spec import DeviceIdentity

_UNIT = "unit"


@dataclass(frozen=True, slots=True)
class KnownStream:
    """One stream of a known program.

    Attributes
    ----------
    program
        Common name of the program.
    name, content_type, source_id
        Patterns that must match the stream's fields whole. A group ``unit`` in one of them
        identifies the device; without one, the host does.
    sensor, data_name
        Names that the stream gets.
    labels
        One per channel, for a stream with this number of channels and no labels.
    units
        By label, for channels without a unit.
    source
        Reference for the stream's fields.
    """

    program: str
    name: str
    sensor: str
    data_name: str
    source: str
    content_type: str = ".*"
    source_id: str = ".*"
    labels: tuple[str, ...] = ()
    units: Mapping[str, str] = field(default_factory=dict[str, str])

    def identity(
        self, name: str, content_type: str, source_id: str, hostname: str
    ) -> DeviceIdentity | None:
        """Return the identity of a stream; None if it is not this one."""
        pairs = (
            (self.name, name),
            (self.content_type, content_type),
            (self.source_id, source_id),
        )
        unit = hostname
        for pattern, text in pairs:
            match = re.fullmatch(pattern, text, re.DOTALL)
            if match is None:
                return None
            unit = match.groupdict().get(_UNIT) or unit
        return DeviceIdentity(self.sensor, unit)

    def labelled(self, labels: tuple[str, ...]) -> tuple[str, ...]:
        """Return the channels' labels; those of this table if the stream has none."""
        return self.labels if len(self.labels) == len(labels) and not any(labels) else labels

    def with_units(self, labels: tuple[str, ...], units: tuple[str, ...]) -> tuple[str, ...]:
        """Return the channels' units; those of this table where the stream has none."""
        return tuple(
            unit or self.units.get(label, "") for label, unit in zip(labels, units, strict=True)
        )


_NEON = "docs.pupil-labs.com: Neon, data collection, Lab Streaming Layer"
_RELAY = "github.com/pupil-labs/lsl-relay: outlets.py, channels.py"
_TITTA = "github.com/dcnieho/Titta: LSL_streamer"
_TOBII_APP = "github.com/labstreaminglayer/App-TobiiPro: mainwindow.cpp"
_EMOTIV = "github.com/Emotiv/labstreaminglayer: README"
_OPENBCI = "github.com/OpenBCI/OpenBCI_GUI: W_Networking.pde, NetworkStreamOut.pde"
_OPENSIGNALS = "PLUX, OpenSignals: Lab Streaming Layer"
_MNE = "github.com/mne-tools/mne-lsl: player_lsl.py"

_EYE_STATE = ("PupilDiameter", "EyeballCenterX", "EyeballCenterY", "EyeballCenterZ")
_NEON_UNITS = {"x": "pixels", "y": "pixels"} | dict.fromkeys(_EYE_STATE, "mm")
_TITTA_STREAMS = {
    "gaze": "gaze",
    "eye_?[oO]penness": "eye_openness",
    "external_?[sS]ignal": "external_signal",
    "time_?[sS]ync": "time_sync",
    "positioning": "positioning",
}
# Electrodes of all headsets: EPOC's first, then those that only Flex can have.
_ELECTRODES = (
    *("AF3", "AF4", "F3", "F4", "F7", "F8", "FC5", "FC6", "T7", "T8", "P7", "P8", "O1", "O2", "Pz"),
    *("AFz", "Cz", "Fz", "Oz", "C3", "C4", "CP1", "CP2", "CP5", "CP6", "FC1", "FC2", "Fp1", "Fp2"),
    *("FT9", "FT10", "P3", "P4", "PO9", "PO10", "TP9", "TP10"),
)
_COUNTED = ("Timestamp", "Counter", "Interpolate")
_ACCELERATION, _FIELD = ("ACCX", "ACCY", "ACCZ"), ("MAGX", "MAGY", "MAGZ")
_METRICS = ("Engagement", "Excitement", "Focus", "Interest", "Relaxation", "Stress")
_SECONDS = {"Timestamp": "s"}
_EMOTIV_STREAMS: tuple[tuple[str, str, tuple[str, ...], Mapping[str, str]], ...] = (
    ("EEG", "eeg", (), _SECONDS | dict.fromkeys(_ELECTRODES, "microvolts")),
    (
        "Motion",
        "motion",
        (*_COUNTED, "Q0", "Q1", "Q2", "Q3", *_ACCELERATION, *_FIELD),
        _SECONDS | dict.fromkeys(_ACCELERATION, "g") | dict.fromkeys(_FIELD, "uT"),
    ),
    ("Performance[- ]Metrics", "performance_metrics", ("Timestamp", *_METRICS), _SECONDS),
    ("Contact[- ]Quality", "contact_quality", (), _SECONDS | {"BatteryPercent": "percent"}),
    ("EEG[- ]Quality", "eeg_quality", (), _SECONDS),
    ("Band[- ]Power", "band_power", (), _SECONDS),
)

KNOWN: tuple[KnownStream, ...] = (
    KnownStream(
        "Pupil Labs Neon Companion", "(?P<unit>.+)_Neon Gaze", "pupil_neon", "gaze", _NEON,
        units=_NEON_UNITS,
    ),
    KnownStream(
        "Pupil Labs Neon Companion", "(?P<unit>.+)_Neon Events", "pupil_neon", "events", _NEON
    ),
    KnownStream(
        "Pupil Labs LSL Relay", "pupil_labs_Gaze", "pupil_invisible", "gaze", _RELAY,
        source_id="(?P<unit>.*)_Gaze", labels=("x", "y"), units={"x": "pixels", "y": "pixels"},
    ),
    KnownStream(
        "Pupil Labs LSL Relay", "pupil_labs_Event", "pupil_invisible", "events", _RELAY,
        source_id="(?P<unit>.*)_Event",
    ),
    *(
        KnownStream(
            "Titta (Tobii Pro)", f"Tobii_{name}", "tobii", data_name, _TITTA,
            source_id="TittaLSL:.*@(?P<unit>.*)",
        )
        for name, data_name in _TITTA_STREAMS.items()
    ),
    KnownStream(
        "LSL app for Tobii Pro", "Tobii", "tobii", "gaze", _TOBII_APP,
        content_type="Gaze", source_id="Tobiiat_(?P<unit>.*)",
        labels=("left_x", "left_y", "left_pupil", "right_x", "right_y", "right_pupil"),
    ),
    *(
        KnownStream(
            "EmotivPRO", f"EmotivDataStream-{name}", "emotivpro", data_name, _EMOTIV,
            labels=labels, units=units,
        )
        for name, data_name, labels, units in _EMOTIV_STREAMS
    ),
    *(
        KnownStream(
            "OpenBCI GUI", f"obci_eeg{number}", "openbci", f"eeg{number}", _OPENBCI,
            source_id="openbcigui",
        )
        for number in (1, 2, 3)
    ),
    KnownStream(
        "OpenSignals (PLUX, BITalino)", "OpenSignals", "opensignals", "data", _OPENSIGNALS,
        content_type="(?P<unit>.*)",
    ),
    KnownStream(
        "MNE-LSL", "MNE-LSL-Player", "mne_lsl_player", "data", _MNE, source_id="(?P<unit>.*)"
    ),
    KnownStream(
        "MNE-LSL", "MNE-LSL-Player-annotations", "mne_lsl_player", "annotations", _MNE,
        source_id="(?P<unit>.*)",
    ),
)  # fmt: skip
"""In the order in which they are tried."""


def known_stream(
    name: str, content_type: str, source_id: str, hostname: str
) -> tuple[KnownStream, DeviceIdentity] | None:
    """Return the entry of a known stream and its device's identity; None if it is unknown."""
    for stream in KNOWN:
        identity = stream.identity(name, content_type, source_id, hostname)
        if identity is not None:
            return stream, identity
    return None
