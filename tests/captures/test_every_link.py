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

from biosensor_common.errors import ConfigError
from biosensor_common.spec import DeviceInfo
from biosensor_gateway.captures import recorder
from biosensor_gateway.captures.draft import Draft
from biosensor_gateway.captures.file import read
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
from tests.rigs.kept_logging import kept_logging

SECONDS = 8.0


class Kind(NamedTuple):
    """A virtual device on a link of its kind.

    Attributes
    ----------
    stream
        One that it has.
    secrets
        What must not be in the file.
    """

    make: Callable[[World], VirtualDevice]
    stream: str
    secrets: Sequence[str] = ()


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
        ("brainflow", "values and not the bytes"),
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
        recorder.taken(recorder.Recorder(), device, DeviceTest(info=DeviceInfo()))
