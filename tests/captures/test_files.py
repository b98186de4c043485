"""The captures of real devices, through today's drivers."""

from __future__ import annotations

from pathlib import Path

import pytest

from biosensor_common.errors import ConfigError, ConfigReason
from biosensor_gateway.captures.file import ENDING, read
from biosensor_gateway.captures.replay import replay
from tests.docs.worked_with import captures
from tests.zephyr import recorded_capture


@pytest.mark.seam
def test_every_capture_is_decoded_and_has_a_licence() -> None:
    assert captures()
    for path in captures():
        capture = read(path)
        licence = path.with_name(path.name.removesuffix(ENDING) + ".LICENSE.txt")
        assert capture.header.licence, path
        assert licence.read_text("utf-8").strip(), path
        report = replay(capture)
        assert report.streams, path
        assert report.problems == [], path


def test_the_recording_of_a_real_device_is_kept_as_a_capture() -> None:
    kept = read(recorded_capture.FILE)
    assert kept == recorded_capture.capture()
    came = b"".join(each.bytes for each in kept.events if each.what == "came")
    name = recorded_capture.RECORDING_150_S
    recorded = (recorded_capture.FOLDER / f"{name}.dat").read_bytes()
    # The times of the reads end a byte before.
    assert came == recorded[:-1]


def test_a_capture_that_was_cut_short_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "cut.capture.gz"
    file.write_bytes(recorded_capture.FILE.read_bytes()[:-1000])
    with pytest.raises(ConfigError, match="cut short") as caught:
        read(file)
    assert caught.value.reason is ConfigReason.UNREADABLE
