"""The wheel as it is installed, outside of any checkout and without ROS: its first minute."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.wheel.conftest import Installed

pytestmark = pytest.mark.seam


def test_it_shows_itself_without_hardware_and_without_ros(tmp_path: Path, wheel: Path) -> None:
    installed = Installed(tmp_path, wheel)
    said = installed.run("try", "--no-open", "--seconds", "3")
    assert "http://127.0.0.1:" in said
    assert "3 sensors stream." in said
    assert "Recording for 3 s" in said
    kept = tmp_path / "biosensor-gateway-try"
    assert len([*kept.glob("*.xdf")]) == 1
    assert len([*kept.glob("*_csv/*.csv")]) > 10
    # Nothing else stays.
    assert [*installed.home.iterdir()] == []
