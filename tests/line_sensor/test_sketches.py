"""The sketches of the sensor's page, compiled for this computer, against the settings in them."""

from __future__ import annotations

import os
import re
import shutil
import socket
import subprocess
import tomllib
from pathlib import Path

import pytest

from biosensor_gateway.devices.line_sensor.driver import row_protocol
from biosensor_gateway.devices.line_sensor.driver.emitter import LineEmitter
from biosensor_gateway.devices.line_sensor.driver.protocol import BadLine, Row
from biosensor_gateway.devices.line_sensor.driver.settings import LineSettings
from biosensor_gateway.devices.registry import declared
from tests.rigs.emitter_sink import EmitterSink

HERE = Path(__file__).parent / "arduino"
PAGES = Path(__file__).parents[2] / "docs" / "sensors" / "line_sensor"
LOOKS = 50

pytestmark = [
    pytest.mark.nightly,
    pytest.mark.skipif(shutil.which("g++") is None, reason="there is no compiler"),
]


def settings_in(sketch: Path) -> LineSettings:
    """The table in the comment at the sketch's head."""
    lines = re.findall(r"^//   (.*)$", sketch.read_text(encoding="utf-8"), re.MULTILINE)
    (table,) = tomllib.loads("\n".join(lines))["device"]
    return LineSettings.model_validate(table)


def compiled(sketch: Path, folder: Path) -> Path:
    program = folder / sketch.stem
    warnings = ("-Wall", "-Wextra", "-Werror")
    command = ["g++", "-std=c++17", *warnings, f'-DSKETCH="{sketch}"', f"-I{HERE}", "-o"]
    subprocess.run([*command, str(program), str(HERE / "main.cpp")], check=True)
    return program


def check(settings: LineSettings, found: list[Row | BadLine]) -> None:
    rows = [each for each in found if not isinstance(each, BadLine)]
    assert rows == found
    assert [row[0] for row in rows] == list(range(int(rows[0][0]), LOOKS))
    spec = declared(settings)
    sink = EmitterSink(spec.name, spec)
    LineEmitter(settings, sink).take(rows, 1000.0)
    assert sink.losses == {}
    assert sink.restarts == []
    names = [stream.data_name for stream in spec.streams]
    assert sorted(sink.emitted) == sorted(names)
    for name in names:
        times = sink.device_times[name]
        assert times == pytest.approx([number / 100 for number in range(len(rows))])


def test_the_sketch_for_a_serial_port(tmp_path: Path) -> None:
    sketch = PAGES / "line_serial" / "line_serial.ino"
    settings = settings_in(sketch)
    said = subprocess.run(
        [compiled(sketch, tmp_path), str(LOOKS)], check=True, stdout=subprocess.PIPE
    ).stdout
    found = row_protocol(settings).feed(said)
    assert len(found) == LOOKS - 1, "the first line of a port may be half of one"
    check(settings, found)


def test_the_sketch_for_an_esp32(tmp_path: Path) -> None:
    sketch = PAGES / "line_udp" / "line_udp.ino"
    settings = settings_in(sketch)
    program = compiled(sketch, tmp_path)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as agent:
        agent.bind(("127.0.0.1", 0))
        environment = {**os.environ, "AGENT_PORT": str(agent.getsockname()[1])}
        subprocess.run([program, str(LOOKS)], check=True, env=environment)
        agent.settimeout(5.0)
        protocol = row_protocol(settings)
        found = [row for _ in range(LOOKS) for row in protocol.feed_whole(agent.recv(2048))]
    check(settings, found)
