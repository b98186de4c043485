"""What the page's server keeps between requests."""

from __future__ import annotations

import traceback
from pathlib import Path

import pytest

from biosensor_common.errors import ConfigError
from biosensor_gateway.page.session import Session


def test_settings_that_cannot_be_read_do_not_fill_the_memory(tmp_path: Path) -> None:
    # They are asked for with each status, twice a second for each window.
    path = tmp_path / "settings.toml"
    path.write_text("nonsense")
    session = Session(tmp_path, path)

    def frames() -> int:
        with pytest.raises(ConfigError) as caught:
            session.loaded()
        return len(traceback.extract_tb(caught.value.__traceback__))

    first = frames()
    for _ in range(10):
        session.status()
    assert frames() == first
