"""The reader of bags that were recorded live reads a recording that was made a bag."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from biosensor_common.ros_clock import NS_PER_S
from biosensor_gateway.recording.contents.opening import open_contents
from tests.bags import made
from tests.system import bag_reader
from tests.xdf import xdf_file

SAMPLES = 60


@pytest.mark.parametrize(
    ("sensor", "data"), [("zephyr", "ecg"), ("emotiv_insight", "eeg"), ("empatica_e4", "acc")]
)
def test_values_times_numbers_and_channels_are_the_recordings(
    tmp_path: Path, sensor: str, data: str
) -> None:
    header, channels = made.declared(1, sensor, data, "p01")
    values = np.arange(SAMPLES * channels, dtype=np.float32).reshape(SAMPLES, channels) / 4
    stamps = 5000 + np.arange(SAMPLES) / 64
    parts = [
        xdf_file.samples(1, "float32", values[at : at + 7].tolist(), stamps[at : at + 7].tolist())
        for at in range(0, SAMPLES, 7)
    ]
    (tmp_path / "a.xdf").write_bytes(made.dated(header, *parts))
    made.to_bag(tmp_path / "a.xdf", tmp_path / "a")
    topics = bag_reader.read(tmp_path / "a")
    read = topics[f"/p01/biosensors/{sensor}/{data}_stamped"]
    with open_contents(tmp_path / "a.xdf") as contents:
        (stream,) = contents.streams
        wall = contents.wall
        assert wall is not None
        expected_ns = wall.to_unix_ns(np.concatenate([each.times for each in stream.blocks()]))
    np.testing.assert_array_equal(read.track.values, values)
    np.testing.assert_array_equal(read.track.times_ns, expected_ns)
    assert np.ptp(read.track.times_ns) / NS_PER_S == pytest.approx(np.ptp(stamps), abs=1e-6)
    assert read.track.labels == stream.header.labels
    assert read.track.units == stream.meaning.units
    assert read.sequences.tolist() == list(range(SAMPLES))
    assert read.frame_ids == {f"p01/{sensor}"}
