"""The captures of real devices, through today's drivers."""

from __future__ import annotations

from pathlib import Path

import pytest

from biosensor_common.errors import ConfigError, ConfigReason
from biosensor_gateway.captures.file import ENDING, Arrivals, read
from biosensor_gateway.captures.replay import replay
from tests.docs.worked_with import captures
from tests.emotibit import recorded_capture as recorded_emotibit
from tests.zephyr import recorded_capture

EXCERPT = Path(__file__).parents[1] / "emotibit" / "vectors" / "real_channels_read_apart.csv"


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


def test_what_a_real_device_wrote_to_its_card_is_kept_as_a_capture() -> None:
    kept = read(recorded_emotibit.FILE)
    came = b"".join(each.bytes for each in kept.events if each.at == "data")
    assert EXCERPT.read_bytes() in came
    assert recorded_emotibit.capture(came.splitlines()) == kept


def test_where_arrivals_are_not_known_nothing_is_said_of_stamps() -> None:
    kept = read(recorded_emotibit.FILE)
    short = kept.model_copy(update={"events": kept.events[:200]})
    report = replay(short)
    assert report.streams["ppg"].samples > 50
    assert [each.median_s for each in report.streams.values() if each.median_s is not None] == []
    known = short.header.model_copy(update={"arrivals": Arrivals.MEASURED})
    measured = replay(short.model_copy(update={"header": known}))
    assert measured.streams["ppg"].median_s is not None
    assert set(report.notes) - set(measured.notes)


def test_a_capture_that_was_cut_short_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "cut.capture.gz"
    file.write_bytes(recorded_capture.FILE.read_bytes()[:-1000])
    with pytest.raises(ConfigError, match="truncated") as caught:
        read(file)
    assert caught.value.reason is ConfigReason.UNREADABLE
