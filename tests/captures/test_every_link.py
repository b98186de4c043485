"""A device on any kind of link is captured, its identifiers are replaced, and it is replayed.

The devices are virtual ones, whose truth tells what was sent. What is searched for in the file is
what they were given, not what the capture says it has replaced.
"""

from __future__ import annotations

import asyncio
import gzip
import json
import os
from collections.abc import Callable, Generator, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from biosensor_common.errors import ConfigError, ConfigReason
from biosensor_common.spec import DeviceInfo
from biosensor_gateway.captures import recorder
from biosensor_gateway.captures.draft import Draft
from biosensor_gateway.captures.file import ENDING, Arrivals, read
from biosensor_gateway.captures.recorder import take
from biosensor_gateway.captures.replay import replay
from biosensor_gateway.devices.emotibit.simulator import SimulatedEmotiBit
from biosensor_gateway.devices.emotiv_insight.simulator import SimulatedCortex
from biosensor_gateway.devices.line_sensor.simulator import (
    OpenEarableLineSensor,
    SimulatedLineSensor,
    StructLineSensor,
    UdpLineSensor,
    WebSocketLineSensor,
)
from biosensor_gateway.devices.registry import driver
from biosensor_gateway.doctor.device_test import DeviceTest
from biosensor_gateway.settings.models import DeviceSettings
from biosensor_gateway.simulation.virtual_device import VirtualDevice
from biosensor_gateway.simulation.world import World
from biosensor_gateway.transports.tap import Passed, Tap, What
from tests.docs.worked_with import captures
from tests.emotibit import recorded_capture as recorded_emotibit
from tests.rigs.kept_logging import kept_logging
from tests.zephyr import recorded_capture

SECONDS = 8.0


class Kind(NamedTuple):
    """A virtual device on a link of its kind."""

    make: Callable[[World], VirtualDevice]
    stream: str  # One that it has.
    secrets: Sequence[str] = ()  # What must not be in the file.


KINDS = {
    "serial": Kind(SimulatedLineSensor, "acc"),
    "struct": Kind(StructLineSensor, "acc"),
    "udp": Kind(UdpLineSensor, "acc"),
    "websocket": Kind(WebSocketLineSensor, "acc"),
    "openearable": Kind(
        partial(OpenEarableLineSensor, wearables=["Renates OpenEarable"]),
        "acc",
        ["Renates", "id-0"],
    ),
    "emotibit": Kind(
        partial(SimulatedEmotiBit, device="MD-V5-0004711"),
        "eda",
        ["MD-V5-0004711", "0004711"],
    ),
    "cortex": Kind(
        partial(SimulatedCortex, headset="INSIGHT-5AF4C39E"),
        "eeg",
        [
            "5AF4C39E",
            "virtual_user",
            "0b5a2f7e-virtual-licence",
            SimulatedCortex.client_id,
            SimulatedCortex.client_secret,
            '"participant"',
        ],
    ),
}


@pytest.fixture(autouse=True)
def restore_logging() -> Iterator[None]:
    with kept_logging():
        yield


@pytest.fixture(params=KINDS)
def kind(request: pytest.FixtureRequest) -> Kind:
    return KINDS[request.param]


@pytest.fixture
def device(kind: Kind, monkeypatch: pytest.MonkeyPatch) -> Generator[DeviceSettings]:
    with World() as world, kind.make(world) as virtual:
        for name, value in getattr(virtual, "environment", {}).items():
            monkeypatch.setenv(name, value)
        sensor = virtual.sensor
        fields = {"sensor": sensor, "unit": "U1", "participant": "Renate", **virtual.settings}
        yield driver(sensor).settings.model_validate(fields)


async def test_it_is_captured_without_identifiers_and_replayed(
    kind: Kind, device: DeviceSettings, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    taken = await take(device, SECONDS)
    draft = Draft(taken, "a virtual device")
    file = draft.save(tmp_path)
    lines = gzip.decompress(file.read_bytes()).decode()
    passed = b"\n".join(
        bytes.fromhex(json.loads(line).get("data", "")) for line in lines.splitlines()
    ).decode("latin-1")
    for secret in (*kind.secrets, "Renate"):
        assert secret not in passed
        assert secret not in lines
    replaced = {each.secret for each in taken.replaced}
    assert len(replaced) >= bool(kind.secrets)
    for name in [each for each in os.environ if each.startswith("EMOTIV")]:
        monkeypatch.delenv(name)
    decoded = await asyncio.to_thread(replay, read(file))
    assert (decoded.connections, decoded.problems, decoded.dropped_bytes) == (1, [], 0)
    told: dict[str, Any] = {name: each.samples for name, each in taken.test.streams.items()}
    assert kind.stream in decoded.streams
    for name, stream in decoded.streams.items():
        # The last samples of the capture may have been in work when it ended.
        assert stream.lost == 0
        assert abs(stream.samples - told[name]) <= 0.05 * told[name] + 2, name


@pytest.mark.parametrize(
    ("sensor", "why"),
    [
        ("brainflow", "values and not the device's bytes"),
        ("polar_broadcast", "without a connection"),
    ],
)
def test_what_cannot_be_captured_says_why_and_what_to_send_instead(sensor: str, why: str) -> None:
    model = driver(sensor).settings
    fields = {"sensor": sensor, "unit": "U1", "board": "SYNTHETIC_BOARD"}
    device = model.model_validate(
        {name: fields[name] for name in fields if name in model.model_fields}
    )
    with pytest.raises(ConfigError, match=f"{why}.*send a recording instead"):
        recorder.taken(Tap(), device, DeviceTest(info=DeviceInfo()))


def test_a_name_in_a_column_is_replaced_where_it_stands_and_where_it_passes(
    tmp_path: Path,
) -> None:
    fields = {"sensor": "line_sensor", "unit": "U1", "port": "/dev/ttyUSB0", "format": "json"}
    columns = ("ecg/Renate_left [mV]", "gsr/Renates skin [uS]")
    device = driver("line_sensor").settings.model_validate({**fields, "columns": columns})
    tapped = Tap()
    link = tapped.opened(None, ())
    for second in range(5):
        line = b'{"Renate_left": %d, "Renates skin": 2.5}\n' % second
        tapped.passed(link, Passed(What.CAME, "", line, second, second))
    taken = recorder.taken(tapped, device, DeviceTest(info=DeviceInfo()))
    text = "\n".join(Draft(taken).whole())
    came = b"".join(each.bytes for each in taken.capture.events)
    assert "Renate" not in text
    assert b"Renate" not in came
    # What tells what is measured stays, and the driver still reads it.
    kept = taken.capture.header.settings["columns"]
    assert [each.split("/")[0] for each in kept] == ["ecg", "gsr"]
    assert {each.secret for each in taken.replaced} == {"Renate", "Renates"}
    # A serial link's first line may be the rest of one.
    report = replay(read(Draft(taken).save(tmp_path)))
    assert {name: each.samples for name, each in report.streams.items()} == {"ecg": 4, "gsr": 4}


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
