"""A page captures a device: it sees how far it is, shows what would leave, and saves or not."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator, Iterator
from pathlib import Path

import pytest

from biosensor_common.errors import ConfigError, ConfigReason
from biosensor_gateway.captures.draft import AGREED, CaptureDesk, Phase
from biosensor_gateway.captures.file import ENDING, read
from biosensor_gateway.captures.replay import replay
from biosensor_gateway.demo.virtual_devices import simulated_settings
from biosensor_gateway.settings.models import DeviceSettings
from tests.rigs.kept_logging import kept_logging
from tests.rigs.polling import until

SECONDS = 8.0


@pytest.fixture(autouse=True)
def restore_logging() -> Iterator[None]:
    with kept_logging():
        yield


@pytest.fixture
def device() -> Iterator[DeviceSettings]:
    with simulated_settings(["polar_h10"]) as loaded:
        yield loaded.devices[0]


@pytest.fixture
async def desk() -> AsyncGenerator[CaptureDesk]:
    desk = CaptureDesk()
    yield desk
    await desk.discard()


async def reached(desk: CaptureDesk, *phases: Phase) -> None:
    await until(lambda: desk.progress.phase in phases)


async def test_what_is_shown_can_be_saved_and_replayed(
    desk: CaptureDesk, device: DeviceSettings, tmp_path: Path
) -> None:
    assert desk.progress.phase is Phase.NONE
    desk.start(device, SECONDS, "a virtual device")
    await reached(desk, Phase.CAPTURING)
    with pytest.raises(ConfigError) as caught:
        desk.start(device, SECONDS)
    assert caught.value.reason is ConfigReason.IN_USE
    await reached(desk, Phase.READY, Phase.FAILED)
    told = desk.progress
    assert (told.phase, told.sensor, told.elapsed_s) == (Phase.READY, "polar_h10", SECONDS)
    assert told.packets > 10
    assert desk.draft is not None
    shown = "\n".join(desk.draft.lines)
    assert "device: polar_h10" in shown
    assert "address: " in shown
    whole = list(desk.draft.whole())
    file = desk.save(tmp_path, "all well")
    capture = read(file)
    assert [event.model_dump_json(exclude_defaults=True) for event in capture.events] == whole[1:]
    header = capture.header
    assert (header.consent, header.note, header.source) == (AGREED, "all well", "a virtual device")
    assert (desk.progress.phase, desk.draft) == (Phase.NONE, None)
    report = await asyncio.to_thread(replay, capture)
    assert (report.connections, report.problems) == (1, [])


async def test_what_is_thrown_away_is_gone(desk: CaptureDesk, device: DeviceSettings) -> None:
    desk.start(device, SECONDS)
    await reached(desk, Phase.CAPTURING)
    await desk.discard()
    assert (desk.progress.phase, desk.draft) == (Phase.NONE, None)
    with pytest.raises(ConfigError) as caught:
        desk.save(Path())
    assert caught.value.reason is ConfigReason.NOT_FOUND


async def test_a_device_that_is_not_there_is_told_in_a_sentence(
    desk: CaptureDesk, device: DeviceSettings
) -> None:
    desk.start(device.model_copy(update={"device": "00:00:00:00:00:01"}), SECONDS)
    await reached(desk, Phase.READY, Phase.FAILED)
    assert desk.progress.phase is Phase.FAILED
    assert desk.progress.problem.startswith("nothing could be captured: ")


async def test_no_file_is_overwritten(
    desk: CaptureDesk, device: DeviceSettings, tmp_path: Path
) -> None:
    file = tmp_path / f"mine{ENDING}"
    file.write_bytes(b"theirs")
    desk.start(device, SECONDS)
    await reached(desk, Phase.READY)
    with pytest.raises(ConfigError) as caught:
        desk.save(file)
    assert caught.value.reason is ConfigReason.EXISTS
    assert file.read_bytes() == b"theirs"
    assert desk.draft is not None
