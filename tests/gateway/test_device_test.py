"""``biosensor-gateway test``: it tells what a device sends and what is wrong with it."""

from __future__ import annotations

import asyncio
import json
import math
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pylsl
import pytest

from biosensor_gateway.devices.driver import Connected, Driver, DriverEntry
from biosensor_gateway.devices.polar_h10.simulator import SimulatedPolarH10
from biosensor_gateway.devices.zephyr.driver import ZephyrSettings
from biosensor_gateway.devices.zephyr.simulator import SimulatedZephyr
from biosensor_gateway.doctor import device_test
from biosensor_gateway.settings.models import DeviceSettings
from biosensor_gateway.simulation.faults import Fault, FaultKind
from biosensor_gateway.simulation.radio import Radio
from biosensor_gateway.simulation.virtual_device import VirtualDevice
from biosensor_gateway.simulation.world import World
from biosensor_gateway.streaming.sink import DeviceSink
from biosensor_gateway.transports import ble_choice
from tests.rigs.polling import wait_until

if TYPE_CHECKING:
    from tests.gateway.conftest import Outcome

pytestmark = pytest.mark.nightly

Run = Callable[..., "Outcome"]


@pytest.fixture
def zephyr(world: World) -> Iterator[SimulatedZephyr]:
    with SimulatedZephyr(world, seed=1) as device:
        yield device


@pytest.fixture
def configure(settings: Path) -> Callable[..., None]:
    """Write settings with these devices."""

    def write(*devices: dict[str, Any]) -> None:
        settings.parent.mkdir(exist_ok=True)
        blocks = [
            "\n".join(["[[device]]", *(f"{key} = {json.dumps(each[key])}" for key in each)])
            for each in devices
        ]
        settings.write_text("\n".join(blocks))

    return write


def of(device: VirtualDevice, unit: str = "U1") -> dict[str, Any]:
    return {"sensor": device.sensor, "unit": unit, **device.settings}


def problems(outcome: Outcome) -> list[str]:
    """What the command complains about; its exit code must say so, too."""
    found = [line[2:] for line in outcome.out.splitlines() if line.startswith("! ")]
    assert outcome.code == (1 if found else 0)
    assert ("no problem found" in outcome.out) is not bool(found)
    return found


def one_sentence(outcome: Outcome) -> str:
    assert (outcome.code, outcome.out) == (2, "")
    assert outcome.err.startswith("biosensor-gateway: ")
    assert outcome.err.count("\n") == 1
    return outcome.err


def test_a_sound_device_has_no_problem_and_streams_nothing(run: Run) -> None:
    heard = pylsl.ContinuousResolver(forget_after=60.0)
    outcome = run("test", "zephyr", "--simulate", "--seconds", "5", "--json")
    assert (outcome.code, outcome.err) == (0, "")
    told = json.loads(outcome.out)
    assert told.keys() == {
        "connected", "model", "serial_number", "firmware_version", "problems", "streams"
    }  # fmt: skip
    assert (told["connected"], told["problems"]) == (True, [])
    for stream in told["streams"].values():
        assert stream.keys() == {"samples", "nominal_hz", "measured_hz", "last"}
    ecg = told["streams"]["ecg"]
    assert ecg["nominal_hz"] == 250
    assert ecg["measured_hz"] == pytest.approx(250, rel=device_test.RATE_TOLERANCE)
    assert ecg["samples"] > 500
    assert [len(told["streams"][name]["last"]) for name in ("ecg", "acc")] == [1, 3]
    assert [info.name() for info in heard.results()] == []


def test_for_people_it_is_a_table(run: Run, configure: Any, zephyr: SimulatedZephyr) -> None:
    configure(of(zephyr))
    outcome = run("test", "zephyr", "--seconds", "5")
    assert (problems(outcome), outcome.err) == ([], "")
    row = next(line.split() for line in outcome.out.splitlines() if line.startswith(" ecg"))
    assert (int(row[1]) > 0, row[3]) == (True, "250")
    assert outcome.out.startswith("connected: ")


def test_without_settings_the_only_one_in_range_is_tried(
    run: Run, world: World, radio: Radio
) -> None:
    with SimulatedPolarH10(world, radio):
        outcome = run("test", "polar_h10", "--seconds", "5")
    assert problems(outcome) == []
    assert "connected: Polar Electro Oy H10 A1B2C3D4" in outcome.out


def test_what_the_settings_switch_off_is_not_missed(
    run: Run, configure: Any, world: World, radio: Radio
) -> None:
    with SimulatedPolarH10(world, radio) as h10:
        configure(of(h10) | {"ecg": False})
        outcome = run("test", "polar_h10", "--seconds", "5", "--json")
    told = json.loads(outcome.out)
    assert (told["connected"], told["problems"]) == (True, [])
    assert told["streams"]["acc"]["samples"] > 0


def test_an_absent_serial_device_is_one_line(run: Run, configure: Any, tmp_path: Path) -> None:
    configure({"sensor": "zephyr", "unit": "U1", "port": str(tmp_path / "ttyNONE")})
    (problem,) = problems(run("test", "zephyr"))
    assert "ttyNONE" in problem


@pytest.mark.usefixtures("radio")
def test_an_absent_bluetooth_device_is_one_line(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ble_choice, "SCAN_S", 0.5)
    outcome = run("test", "polar_h10")
    assert problems(outcome) == [
        "Polar H10 is not in range; put it on with wet electrodes, and close the apps that use it"
    ]
    told = json.loads(run("test", "polar_h10", "--json").out)
    assert (told["connected"], told["streams"]) == (False, {})
    assert told["problems"] == problems(outcome)


def test_a_radio_that_is_off_is_one_line(run: Run, radio: Radio) -> None:
    radio.available = False
    (problem,) = problems(run("test", "polar_h10"))
    assert "switch" in problem


def test_a_device_that_refuses_is_not_waited_for(
    run: Run, configure: Any, zephyr: SimulatedZephyr
) -> None:
    configure(of(zephyr))
    zephyr.apply(Fault(FaultKind.REFUSE, math.inf))
    (problem,) = problems(run("test", "zephyr"))
    assert "refuses" in problem


def test_a_device_that_never_answers_is_given_up(
    run: Run, world: World, radio: Radio, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(device_test, "CONNECT_TIMEOUT_S", 1.5)
    with SimulatedPolarH10(world, radio) as strap:
        strap.apply(Fault(FaultKind.LATE, 25.0))
        assert problems(run("test", "polar_h10")) == ["no connection within 1.5 s"]


@pytest.mark.parametrize("sensor", ["zephyr", "polar_h10"])
def test_a_sensor_that_nobody_wears_is_told(
    run: Run, configure: Any, world: World, radio: Radio, sensor: str
) -> None:
    device = SimulatedZephyr(world) if sensor == "zephyr" else SimulatedPolarH10(world, radio)
    with device:
        device.apply(Fault(FaultKind.OFF_BODY, math.inf))
        configure(of(device))
        (problem,) = problems(run("test", sensor, "--seconds", "5"))
    assert "not seem to be on the body" in problem


def test_a_connection_that_breaks_is_told(
    run: Run, configure: Any, zephyr: SimulatedZephyr
) -> None:
    configure(of(zephyr))

    def drop_once_it_streams() -> None:
        wait_until(lambda: len(zephyr.truth.samples("ecg").times) > 0)
        zephyr.apply(Fault(FaultKind.DROP, 0.5))

    with ThreadPoolExecutor() as pool:
        dropped = pool.submit(drop_once_it_streams)
        first = problems(run("test", "zephyr", "--seconds", "8"))[0]
        dropped.result()
    assert first == "the connection broke; it was made 2 times"


class Made:
    """A driver of the test's own."""

    silence_limit_s = 10.0

    def __init__(self, act: Callable[[DeviceSink], None], sink: DeviceSink) -> None:
        self._act = act
        self._sink = sink

    async def connect(self) -> Connected:
        return Connected(rates={"ecg": 250.0, "breathing": 18.0, "acc": 0.0})

    async def stream(self) -> None:
        self._act(self._sink)
        await asyncio.Event().wait()

    async def close(self) -> None:
        pass


@pytest.fixture
def acting(monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Have a driver in place of a sensor's own that does this when it streams."""

    def replace(act: Callable[[DeviceSink], None]) -> None:
        def make(settings: DeviceSettings, sink: DeviceSink) -> Callable[[], Driver]:
            del settings
            return lambda: Made(act, sink)

        entry = DriverEntry(ZephyrSettings, make)
        monkeypatch.setattr(device_test, "driver", {"zephyr": entry}.__getitem__)

    return replace


def test_what_is_too_slow_or_does_not_come_is_told(
    run: Run, configure: Any, acting: Callable[..., None]
) -> None:
    def half_as_fast(sink: DeviceSink) -> None:
        sink.emit_at("ecg", [math.nan] * 100, [number / 125 for number in range(100)])

    configure({"sensor": "zephyr", "unit": "U1", "port": "x"})
    acting(half_as_fast)
    expected = ["ecg: 125.0 samples a second instead of 250", "breathing: no sample arrived"]
    assert problems(run("test", "zephyr", "--seconds", "1")) == expected
    told = json.loads(run("test", "zephyr", "--seconds", "1", "--json").out)
    assert told["problems"] == expected
    # JSON knows no NaN.
    assert told["streams"]["ecg"]["last"] == [None]


def test_a_driver_that_breaks_is_told_without_a_traceback(
    run: Run, configure: Any, acting: Callable[..., None]
) -> None:
    def break_down(sink: DeviceSink) -> None:
        raise RuntimeError(f"no such thing: {sink.identity.unit}")

    configure({"sensor": "zephyr", "unit": "U1", "port": "x"})
    acting(break_down)
    assert problems(run("test", "zephyr", "--seconds", "1"))[0] == "no such thing: U1"


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("toaster",), "toaster"),
        (("toaster", "--simulate"), "toaster"),
        (("zephyr",), "--unit, one of U1, U2"),
        (("zephyr", "--unit", "U3"), "there is U1, U2"),
        (("shimmer3_gsr",), "port"),
        (("polar_h10", "--unit", "U1"), "there is none"),
        (("zephyr", "--settings", "nowhere.toml"), "nowhere.toml"),
    ],
)
def test_what_cannot_be_meant_is_one_sentence(
    run: Run, configure: Any, arguments: tuple[str, ...], words: str
) -> None:
    configure(*({"sensor": "zephyr", "unit": unit, "port": "x"} for unit in ("U1", "U2")))
    assert words in one_sentence(run("test", *arguments))


def test_a_broken_settings_file_is_one_sentence(run: Run, settings: Path) -> None:
    settings.parent.mkdir()
    settings.write_text("[lsl\n")
    assert "not valid TOML" in one_sentence(run("test", "zephyr"))


def test_of_several_the_one_that_is_named_is_tried(
    run: Run, configure: Any, zephyr: SimulatedZephyr
) -> None:
    configure(of(zephyr, "U1"), {"sensor": "zephyr", "unit": "U2", "port": "nowhere"})
    assert problems(run("test", "zephyr", "--unit", "U1", "--seconds", "5")) == []
    (problem,) = problems(run("test", "zephyr", "--unit", "U2"))
    assert "nowhere" in problem


STREAMING = """
from biosensor_gateway import cli
from biosensor_gateway.doctor import device_test

open_really = device_test._TestSink.open

def told(self, info, rates):
    open_really(self, info, rates)
    print("connected", flush=True)

device_test._TestSink.open = told
cli.main()
"""


def test_ctrl_c_ends_a_try_without_a_traceback(configure: Any, zephyr: SimulatedZephyr) -> None:
    configure(of(zephyr))
    command = [sys.executable, "-c", STREAMING, "test", "zephyr", "--seconds", "60"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    assert process.stdout is not None
    assert process.stdout.readline() == b"connected\n"
    wait_until(lambda: len(zephyr.truth.samples("ecg").times) > 0)
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=30)
    assert process.returncode > 0
    assert b"Traceback" not in out + err
