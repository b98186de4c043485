"""The installed program writes recordings in every format, and makes a recording of a bag."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks import long_recording
from biosensor_gateway.recording.export.formats import FORMATS
from biosensor_gateway.recording.xdf.recording import read_recording
from installer.wine.prefix import windows_path
from tests.rigs.windows.pc import WindowsPc

pytestmark = [pytest.mark.system, pytest.mark.timeout(600)]

RECORDED_S = 10.0


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    path = tmp_path / "Aufnahme für p01.xdf"
    long_recording.write(path, RECORDED_S, long_recording.of_a_lab())
    return path


def _samples(path: Path) -> dict[str, int]:
    return {each.header.source_id: each.sample_count for each in read_recording(path).streams}


def test_every_format_is_written_and_a_bag_is_a_recording_again(
    installed: WindowsPc, recording: Path, tmp_path: Path
) -> None:
    for name in FORMATS:
        place = tmp_path / name
        place.mkdir()
        line = ("xdf", "export", windows_path(recording), "--to", name)
        ended = installed.gateway(*line, "--output", windows_path(place))
        assert ended.returncode == 0, (name, ended.stdout)
        assert any(each.stat().st_size for each in place.rglob("*") if each.is_file()), name
    (bag,) = (tmp_path / "mcap").iterdir()
    again = tmp_path / "again.xdf"
    ended = installed.gateway("bag", "import", windows_path(bag), "--output", windows_path(again))
    assert ended.returncode == 0, ended.stdout
    assert _samples(again) == _samples(recording)
