"""What streams of other programs are called, as their makers document them."""

from __future__ import annotations

import pytest

from biosensor_common import naming
from biosensor_common.known_senders import KNOWN
from biosensor_common.quantities import ChannelFormat
from biosensor_common.spec import DeviceIdentity
from biosensor_common.stream_header import CoreFields, foreign_header

HOST = "labpc"
# Name, type and source id as the programs say them, and the topic that a person expects.
STREAMS = [
    ("lab phone_Neon Gaze", "Gaze", "any", "pupil_neon/gaze"),
    ("lab phone_Neon Events", "Event", "any", "pupil_neon/events"),
    ("pupil_labs_Gaze", "Gaze", "a1b2_Gaze", "pupil_invisible/gaze"),
    ("pupil_labs_Event", "Event", "a1b2_Event", "pupil_invisible/events"),
    ("Tobii_gaze", "Gaze", "TittaLSL:Tobii_gaze@TPFC2-0101", "tobii/gaze"),
    ("Tobii_eyeOpenness", "Gaze", "TittaLSL:Tobii_eyeOpenness@TPFC2-0101", "tobii/eye_openness"),
    ("Tobii_time_sync", "TimeSync", "TittaLSL:Tobii_time_sync@T1", "tobii/time_sync"),
    ("Tobii", "Gaze", "Tobiiat_tet-tcp://169.254.10.20", "tobii/gaze"),
    ("EmotivDataStream-EEG", "EEG", "", "emotivpro/eeg"),
    ("EmotivDataStream-Motion", "Motion", "", "emotivpro/motion"),
    ("EmotivDataStream-Performance-Metrics", "", "", "emotivpro/performance_metrics"),
    ("EmotivDataStream-Performance Metrics", "", "", "emotivpro/performance_metrics"),
    ("EmotivDataStream-Band-Power", "", "", "emotivpro/band_power"),
    ("obci_eeg2", "EEG", "openbcigui", "openbci/eeg2"),
    ("OpenSignals", "00:07:80:65:E0:19", "", "opensignals/data"),
    ("MNE-LSL-Player", "eeg", "MNE-LSL", "mne_lsl_player/data"),
    ("MNE-LSL-Player-annotations", "annotations", "MNE-LSL", "mne_lsl_player/annotations"),
]
OTHERS = [
    ("obci_eeg1", "EEG", "somebody's own"),
    ("Tobii", "Gaze", "a script"),
    ("my_Gaze", "Gaze", "a1b2_Gaze"),
    ("OpenSignals2", "EEG", "x"),
    ("xEmotivDataStream-EEG", "EEG", "x"),
]


def _header(
    name: str,
    content_type: str,
    source_id: str,
    channels: int,
    labels: tuple[str, ...] = (),
    units: tuple[str, ...] = (),
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    rate = 100.0
    core = CoreFields(name, content_type, source_id, HOST, channels, rate, ChannelFormat.FLOAT32)
    header = foreign_header(core, labels, units)
    return header.labels, header.units


@pytest.mark.parametrize(("name", "content_type", "source_id", "topic"), STREAMS)
def test_a_known_program_has_topics_that_a_person_expects(
    name: str, content_type: str, source_id: str, topic: str
) -> None:
    found = naming.foreign_identity(name, content_type, source_id, HOST)
    assert naming.topic(*found) == f"biosensors/{topic}"


@pytest.mark.parametrize(("name", "content_type", "source_id"), OTHERS)
def test_another_program_keeps_the_names_that_it_says(
    name: str, content_type: str, source_id: str
) -> None:
    found = naming.foreign_identity(name, content_type, source_id, HOST)
    assert found == (DeviceIdentity(name, source_id), content_type)


def test_every_entry_is_seen_here() -> None:
    seen = {
        (identity.sensor, data_name)
        for identity, data_name in (
            naming.foreign_identity(name, content_type, source_id, HOST)
            for name, content_type, source_id, _ in STREAMS
        )
    }
    missing = {(stream.sensor, stream.data_name) for stream in KNOWN} - seen
    assert {sensor for sensor, _ in missing} <= {"tobii", "emotivpro", "openbci"}


def test_streams_of_one_device_belong_together_and_two_devices_are_told_apart() -> None:
    streams = {
        name: naming.foreign_identity(name, "", f"id of {name}", HOST)
        for phone in ("left", "right")
        for name in (f"{phone}_Neon Gaze", f"{phone}_Neon Events")
    }
    bases = {name: topics.base for name, topics in naming.resolve_topics(streams).items()}
    assert bases["left_Neon Gaze"] == bases["left_Neon Events"] == "biosensors/pupil_neon_left"
    assert bases["right_Neon Gaze"] == "biosensors/pupil_neon_right"


class TestChannels:
    def test_without_a_unit_have_the_documented_one(self) -> None:
        labels = ("x", "y", "PupilDiameter", "PupilDiameter", "something else")
        assert _header("a_Neon Gaze", "Gaze", "", 5, labels) == (
            labels,
            ("pixels", "pixels", "mm", "mm", ""),
        )

    def test_keep_the_units_that_they_say(self) -> None:
        _, units = _header("a_Neon Gaze", "Gaze", "", 2, ("x", "y"), ("degrees", ""))
        assert units == ("degrees", "pixels")

    def test_without_labels_have_the_documented_ones(self) -> None:
        labels, units = _header("EmotivDataStream-Motion", "", "", 13)
        assert labels[3:8] == ("Q0", "Q1", "Q2", "Q3", "ACCX")
        assert units[7] == "g"
        assert units[-1] == "uT"

    def test_are_nameless_where_their_number_is_another(self) -> None:
        assert _header("EmotivDataStream-Motion", "", "", 4) == (("",) * 4, ("",) * 4)
