"""One notion of exit codes: what is missing in what was made is 1, by all commands."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from typer import Exit

from biosensor_common.errors import ConfigError
from biosensor_gateway.cli import features, replay, xdf
from biosensor_gateway.recording.contents.choice import Selection
from biosensor_gateway.recording.replay import playback
from biosensor_gateway.recording.replay.playback import Wanted
from biosensor_gateway.recording.replay.player import Player, PlayOptions
from biosensor_gateway.settings.models import LslSettings
from tests.recording_export import odd_shapes
from tests.recording_export.odd_shapes import COUNT, RATE, made

STAMPS = odd_shapes.BEGIN_S + np.arange(COUNT) / RATE


def _recording(stamps: np.ndarray[tuple[int], np.dtype[np.float64]] = STAMPS) -> bytes:
    return made.xdf(*odd_shapes.nameless(stamps))


def _untimed() -> bytes:
    stamps = STAMPS.copy()
    stamps[700:720] = np.nan
    return _recording(stamps)


FILES: dict[str, tuple[bytes, int]] = {
    "whole": (_recording(), 0),
    "damaged": (_recording()[:-4000], 1),
    "stamps that are no numbers": (_untimed(), 1),
    "no recording": (b"hello there", 2),
}


def _check(path: Path) -> None:
    xdf.check(path)


def _export(form: str) -> Callable[[Path], None]:
    return lambda path: xdf.export_recording([path], to=[form])


def _features(path: Path) -> None:
    features.compute_recording(path, None, print_json=False)


def _replay(path: Path) -> None:
    wanted = Wanted(path, Selection(), PlayOptions(speed=1e6), may_be_beside=True)
    asyncio.run(replay.play(wanted, LslSettings()))


COMMANDS: dict[str, Callable[[Path], None]] = {
    "check": _check,
    **{f"export to {each}": _export(each) for each in ("csv", "edf", "bids", "kubios", "mcap")},
    "features": _features,
    "replay": _replay,
}


def _nothing(*_args: object, **_options: object) -> None: ...


@pytest.mark.parametrize("file", FILES)
@pytest.mark.parametrize("command", COMMANDS)
def test_each_command_has_the_code_of_all(
    command: str, file: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "rec.xdf"
    content, expected = FILES[file]
    path.write_bytes(content)
    # What is played is of no interest here, and the network would take seconds.
    for place, name in ((playback, "refuse_if_present"), (Player, "offer"), (Player, "run")):
        monkeypatch.setattr(place, name, _nothing)
    try:
        COMMANDS[command](path)
        code = 0
    except Exit as ended:
        code = ended.exit_code
    except ConfigError:
        code = 2
    assert code == expected
