"""Which sensors there are, and their virtual devices as the command line asks for them."""

from __future__ import annotations

import contextlib
import json
import subprocess
import sys
import threading
from collections.abc import Callable, Generator, Iterable, Mapping
from importlib import invalidate_caches
from math import inf, nan
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, cast

import pytest
from hypothesis import given
from hypothesis import strategies as st

from biosensor_common.errors import ConfigError, ConfigReason, GatewayError, SpecError, SpecReason
from biosensor_common.spec import SensorSpec
from biosensor_gateway import devices
from biosensor_gateway.agent import status_file
from biosensor_gateway.cli import agent_process
from biosensor_gateway.demo import demonstration, virtual_devices
from biosensor_gateway.demo.virtual_devices import Wanted, turns_of, virtual_class, virtual_names
from biosensor_gateway.devices.registry import (
    ENTRY_POINT_GROUP,
    declaration,
    declaration_names,
    driver,
    sensor,
    sensor_names,
)
from biosensor_gateway.settings.models import GatewaySettings
from biosensor_gateway.simulation import virtual_device
from biosensor_gateway.simulation.faults import (
    Effect,
    Fault,
    FaultKind,
    Kind,
    OfWearer,
    ScheduledFault,
    Untidiness,
    parse_fault,
)
from biosensor_gateway.simulation.virtual_device import VirtualDevice
from biosensor_gateway.simulation.world import World
from biosensor_gateway.system.logs import LOG_FILE_NAME
from tests.rigs.gateway import cli_process
from tests.rigs.polling import wait_until

if TYPE_CHECKING:
    from tests.gateway.conftest import Outcome

Install = Callable[[str, dict[str, str]], None]
DEVICES = Path(devices.__file__).parent
BUILT_IN = tuple(sorted(path.parent.name for path in DEVICES.glob("*/__init__.py")))
MODULE = """
from biosensor_common.spec import SensorSpec
from biosensor_gateway.devices.sensor import Sensor

SPEC = SensorSpec("acme_band", "Acme Band", "Acme", "Band", ())
BAND = Sensor(SPEC, driver="acme_sensors:NUMBER")
CRASHING = Sensor(SPEC, driver="acme_crash:DRIVER")
OTHER_NAME = Sensor(SensorSpec("acme_ring", "Acme Ring", "Acme", "Ring", ()), driver="")
ZEPHYR = Sensor(SensorSpec("zephyr", "Not a Zephyr", "Acme", "Band", ()), driver="")
NUMBER = 42
"""


@pytest.fixture
def install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Install:
    """Install a distribution with these sensors, as an installer would leave it on disk."""
    (tmp_path / "acme_sensors.py").write_text(MODULE, encoding="utf-8")
    (tmp_path / "acme_crash.py").write_text("1 / 0\n", encoding="utf-8")
    monkeypatch.setattr(sys, "path", [str(tmp_path), *sys.path])
    monkeypatch.setattr(sys, "modules", dict(sys.modules))

    def write(distribution: str, sensors: dict[str, str]) -> None:
        folder = tmp_path / f"{distribution.replace('-', '_')}-1.0.dist-info"
        folder.mkdir()
        metadata = f"Metadata-Version: 2.1\nName: {distribution}\nVersion: 1.0\n"
        (folder / "METADATA").write_text(metadata, encoding="utf-8")
        lines = [f"{name} = {value}" for name, value in sensors.items()]
        text = "\n".join([f"[{ENTRY_POINT_GROUP}]", *lines, ""])
        (folder / "entry_points.txt").write_text(text, encoding="utf-8")
        invalidate_caches()

    return write


def refusal(name: str) -> SpecError:
    with pytest.raises(SpecError) as caught:
        declaration(name)
    return caught.value


@pytest.mark.parametrize("name", (*BUILT_IN, "gateway"))
def test_a_built_in_sensor_is_found_under_its_own_name(name: str) -> None:
    assert declaration(name).name == name


def test_all_built_in_sensors_are_listed() -> None:
    assert len(BUILT_IN) > 10
    assert sorted(sensor_names()) == list(BUILT_IN)
    assert declaration_names() == (*sensor_names(), "gateway")


def test_the_generic_ones_come_last_because_what_they_recognise_may_be_anothers() -> None:
    precedences = [sensor(name).precedence for name in sensor_names()]
    assert precedences == sorted(precedences, reverse=True)
    assert precedences[-1] < 0 == precedences[0]


def test_an_unknown_sensor_is_refused_with_the_known_names() -> None:
    error = refusal("zephir")
    assert error.reason is SpecReason.UNKNOWN_SENSOR
    assert "'zephir'" in str(error)
    assert all(name in str(error) for name in BUILT_IN)


@pytest.mark.nightly
def test_a_list_of_sensors_imports_no_driver_and_no_virtual_device() -> None:
    script = """
import sys
from biosensor_gateway.devices.registry import declaration, sensor_names
for name in sensor_names():
    declaration(name)
print(*[name for name in sys.modules if name.startswith("biosensor_gateway.devices.")])
"""
    run = [sys.executable, "-c", script]
    loaded = subprocess.run(run, capture_output=True, text=True, check=True).stdout.split()
    assert {f"biosensor_gateway.devices.{name}" for name in sensor_names()} <= set(loaded)
    assert not [name for name in loaded if name.count(".") > 2]


def test_another_package_adds_a_sensor(install: Install) -> None:
    install("acme-sensors", {"acme_band": "acme_sensors:BAND"})
    assert sorted(sensor_names()) == sorted((*BUILT_IN, "acme_band"))
    assert declaration("acme_band") == SensorSpec("acme_band", "Acme Band", "Acme", "Band", ())


@pytest.mark.parametrize(
    "value",
    [
        pytest.param("acme_missing:BAND", id="no such module"),
        pytest.param("acme_sensors:MISSING", id="no such attribute"),
        pytest.param("acme_crash:BAND", id="fails on import"),
        pytest.param("acme_sensors:NUMBER", id="not a Sensor"),
        pytest.param("acme_sensors:OTHER_NAME", id="another name"),
    ],
)
def test_a_broken_sensor_is_refused_with_its_package_and_harms_no_other(
    install: Install, value: str
) -> None:
    install("acme-sensors", {"acme_band": value, "zephyr_two": value})
    assert "acme_band" in declaration_names()
    assert declaration("zephyr").name == "zephyr"
    error = refusal("acme_band")
    assert error.reason is SpecReason.INVALID
    assert "acme-sensors" in str(error)
    assert "'acme_band'" in str(error)


@pytest.mark.parametrize("value", ["acme_sensors:BAND", "acme_sensors:CRASHING"])
def test_a_broken_driver_is_refused_and_harms_no_other(install: Install, value: str) -> None:
    install("acme-sensors", {"acme_band": value})
    with pytest.raises(SpecError, match="The driver of 'acme_band'") as caught:
        driver("acme_band")
    assert caught.value.reason is SpecReason.INVALID
    assert driver("zephyr").settings.__name__ == "ZephyrSettings"


def test_a_sensor_of_two_packages_is_refused_with_both(install: Install) -> None:
    install("acme-sensors", {"acme_band": "acme_sensors:BAND"})
    install("acme-clone", {"acme_band": "acme_sensors:BAND"})
    error = refusal("acme_band")
    assert error.reason is SpecReason.INVALID
    assert "acme-clone, acme-sensors" in str(error)
    assert sorted(sensor_names()) == sorted((*BUILT_IN, "acme_band"))


def test_a_built_in_sensor_cannot_be_replaced(install: Install) -> None:
    install("acme-sensors", {"zephyr": "acme_sensors:ZEPHYR"})
    assert declaration("zephyr").title == "Zephyr BioHarness 3"
    assert sorted(sensor_names()) == list(BUILT_IN)


# Virtual devices with faults, as the command line asks for them.
Run = Callable[..., "Outcome"]
_UNITS = {
    FaultKind.GARBAGE: "",
    FaultKind.STEP_BACK: "",
    FaultKind.FORGET: "",
    FaultKind.LOW_BATTERY: "%",
    FaultKind.DRIFT: "ppm",
}
SHORT_S = 0.05


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("drop:5s@10s", ScheduledFault(Fault(FaultKind.DROP, 5.0), 10.0)),
        ("drop@10", ScheduledFault(Fault(FaultKind.DROP, 5.0), 10.0)),
        (" stall:2.5@0.5s ", ScheduledFault(Fault(FaultKind.STALL, 2.5), 0.5)),
        ("garbage@1", ScheduledFault(Fault(FaultKind.GARBAGE, 64.0), 1.0)),
        ("late@1", ScheduledFault(Fault(FaultKind.LATE, 1.0), 1.0)),
        ("hr:140bpm@30s", ScheduledFault(Fault(OfWearer.HEART_RATE, 140.0), 30.0)),
        ("hr@30", ScheduledFault(Fault(OfWearer.HEART_RATE, 120.0), 30.0)),
        ("low_battery:7%@5s", ScheduledFault(Fault(FaultKind.LOW_BATTERY, 7.0), 5.0)),
        ("low_battery@5s", ScheduledFault(Fault(FaultKind.LOW_BATTERY, 4.0), 5.0)),
        ("drift:-80ppm@0s", ScheduledFault(Fault(FaultKind.DRIFT, -80.0), 0.0)),
        (
            "polar_h10:off_body:20s@15s",
            ScheduledFault(Fault(FaultKind.OFF_BODY, 20.0), 15.0, "polar_h10"),
        ),
        (
            "zephyr:recording:drop@3s",
            ScheduledFault(Fault(FaultKind.DROP, 5.0), 3.0, "zephyr:recording"),
        ),
    ],
)
def test_a_fault_is_read(text: str, expected: ScheduledFault) -> None:
    assert parse_fault(text) == expected


@given(
    kind=st.sampled_from(FaultKind),
    value=st.integers(0, 100),
    start_s=st.integers(0, 10**6),
    sensor=st.sampled_from(["", "zephyr", "empatica_e4"]),
)
def test_what_is_written_is_read_again(
    kind: FaultKind, value: int, start_s: int, sensor: str
) -> None:
    text = f"{sensor}:" * bool(sensor) + f"{kind.value}:{value}{_UNITS.get(kind, 's')}@{start_s}s"
    assert parse_fault(text) == ScheduledFault(Fault(kind, float(value)), float(start_s), sensor)


@given(
    st.text() | st.from_regex(r"[a-z_]{0,8}:?(drop|drift):?-?[0-9.]{0,4}(s|%|ppm)?@?[0-9s]{0,3}")
)
def test_any_other_text_is_refused_in_words(text: str) -> None:
    try:
        parse_fault(text)
    except ConfigError as error:
        assert error.reason is ConfigReason.WRONG_VALUE
        assert repr(text) in str(error)


@pytest.mark.parametrize(
    ("kind", "value"),
    [
        (FaultKind.DROP, -1.0),
        (FaultKind.DROP, nan),
        (FaultKind.GARBAGE, inf),
        (FaultKind.LOW_BATTERY, 101.0),
        (FaultKind.DRIFT, nan),
        # A clock that stands still.
        (FaultKind.DRIFT, -1e6),
    ],
)
def test_a_fault_that_cannot_be_does_not_exist(kind: FaultKind, value: float) -> None:
    with pytest.raises(ValueError, match=f"{kind.value} of .* is not possible"):
        Fault(kind, value)


BAD_FAULTS = (
    "drop",
    "drop:5s",
    "drop@",
    "drop@soon",
    "drop@-1s",
    "drop:five@1s",
    "drop:-5s@1s",
    "drop:inf@1s",
    "drop:5%@1s",
    "low_battery:4s@1s",
    "low_battery:400%@1s",
    "drift:1000000ppm@1s",
    "explode:5s@1s",
    "hr:20@1s",
    "hr:250bpm@1s",
    "hr:5s@1s",
    "Polar:drop:5s@1s",
    "drop:5s@1s@2s",
)


IMPOSSIBLE_FAULTS = (
    ("ble_heart_rate", "refuse:5s@1s", "none of the virtual devices can"),
    ("zephyr:recording,zephyr", "zephyr:recording:off_body@1s", "zephyr:recording cannot"),
    ("polar_h10", "zephyr:drop:5s@1s", "zephyr cannot"),
    ("vernier_respiration_belt", "hr:120@1s", "none of the virtual devices can"),
    ("zephyr:recording", "hr:120@1s", "none of the virtual devices can"),
    ("polar_h10", "zephyr:hr:120@1s", "zephyr cannot"),
)


@pytest.mark.parametrize(
    ("simulated", "fault", "said"),
    [
        *(("polar_h10", fault, repr(fault)) for fault in BAD_FAULTS),
        *((device, fault, f"{who} have the fault ") for device, fault, who in IMPOSSIBLE_FAULTS),
    ],
)
def test_a_fault_that_is_senseless_or_that_nobody_can_have_ends_the_command(
    run: Run, simulated: str, fault: str, said: str
) -> None:
    code, out, err = run("run", "--simulate", simulated, "--fault", fault)
    assert (code, out) == (2, "")
    assert err.startswith(f"biosensor-gateway: {said}")
    assert err.count("\n") == 1


def test_a_heart_beats_for_all_sensors_of_a_person_and_for_nobody_else() -> None:
    scheduled = [parse_fault(each) for each in ("zephyr:hr:90@60s", "polar_h10:hr:120@30s")]
    wanted = [
        Wanted(*each)
        for each in (
            ("polar_h10", "P01"),
            ("shimmer3_gsr", "P01"),
            ("zephyr", "P02"),
            ("empatica_e4", ""),
            ("zephyr", ""),
        )
    ]
    turns = turns_of(wanted, scheduled)
    assert list(turns) == wanted
    first, second = ((60.0, 90.0),), ((30.0, 120.0),)
    assert list(turns.values()) == [second, second, first, (), first]


@pytest.mark.parametrize("kind", [*FaultKind, *Untidiness], ids=lambda kind: kind.value)
def test_every_kind_can_be_given_to_whoever_can_have_it(kind: Kind) -> None:
    whom = [name for name in virtual_names() if kind in virtual_class(name).effects]
    assert whom
    device = Scheduled(virtual_class(whom[0]))
    devices = cast("dict[Wanted, VirtualDevice]", {Wanted(whom[0]): device})
    for text in (f"{kind.value}@7s", f"{whom[0]}:{kind.value}@7s"):
        fault = parse_fault(text)
        virtual_devices._schedule([fault], devices)  # pyright: ignore[reportPrivateUsage]
        assert device.told == (fault.fault, 7.0)


@pytest.mark.parametrize("name", ["nobody", "", "zephyr:", "zephyr:nothing", ":recording"])
def test_what_there_is_not_is_told_with_what_there_is(name: str) -> None:
    with pytest.raises(ConfigError) as raised:
        virtual_class(name)
    assert raised.value.reason is ConfigReason.WRONG_VALUE
    assert str(raised.value).startswith(f"there is no virtual {name!r}")
    assert "; there are " in str(raised.value)
    for there_is in virtual_names():
        assert there_is in str(raised.value)


def test_a_wearer_without_a_name_is_refused() -> None:
    with pytest.raises(ConfigError, match="'polar_h10@' names nobody"):
        virtual_devices.import_all(["polar_h10@"])


@pytest.mark.parametrize("name", ["polarh10", "Polar_H10"])
def test_of_a_misspelt_sensor_the_right_name_is_said(name: str) -> None:
    for look_up in (virtual_class, sensor):
        with pytest.raises(GatewayError, match=r"\(did you mean 'polar_h10'\?\)"):
            look_up(name)


def test_real_devices_are_given_no_faults(run: Run) -> None:
    code, out, err = run("run", "--fault", "drop:5s@10s")
    assert (code, out) == (2, "")
    assert "--simulate" in err


def _noted(kinds: Iterable[FaultKind]) -> Mapping[Kind, Effect[Recording]]:
    return MappingProxyType({kind: _effect(kind.value) for kind in kinds})


def _effect(name: str) -> Effect[Recording]:
    return Effect(
        lambda device, value: device.tell(f"begin {name} {value:g}"),
        lambda device: device.tell(f"end {name}"),
    )


class Recording(VirtualDevice):
    """Notes what it is told."""

    sensor = "recording"
    effects = _noted(frozenset(FaultKind) - {FaultKind.REFUSE})

    def __init__(self, world: World) -> None:
        super().__init__(world)
        self.told: list[str] = []
        self.thread_names: set[str] = set()

    @property
    def settings(self) -> Mapping[str, Any]:
        return {}

    async def _start(self) -> None:
        pass

    async def _stop(self) -> None:
        pass

    def stall(self, _: float) -> None:
        self.tell("stalled")

    def tell(self, what: str) -> None:
        self.thread_names.add(threading.current_thread().name)
        self.told.append(what)


class Scheduled:
    """Stands for a device of a class; notes what is scheduled."""

    def __init__(self, kind: type[VirtualDevice]) -> None:
        self.effects, self.faults = kind.effects, kind.faults
        self.told: tuple[Fault, float] | None = None

    def schedule(self, fault: Fault, after_s: float) -> None:
        self.told = fault, after_s


@pytest.fixture
def device(world: World) -> Generator[Recording]:
    with Recording(world) as living:
        yield living


@pytest.mark.nightly
def test_a_scheduled_fault_begins_and_ends_by_itself(device: Recording) -> None:
    device.schedule(Fault(FaultKind.DROP, SHORT_S), SHORT_S)
    wait_until(lambda: len(device.told) == 2)
    assert device.told == ["begin drop 0.05", "end drop"]
    assert device.thread_names == {"virtual devices"}


def test_a_scheduled_fault_does_not_begin_before_its_time(device: Recording) -> None:
    device.schedule(Fault(FaultKind.DROP, 1.0), 3600.0)
    assert device.told == []


def test_an_endless_fault_ends_when_it_is_cleared(device: Recording) -> None:
    device.apply(Fault(FaultKind.STALL, inf))
    assert device.told == ["begin stall inf"]
    device.clear(FaultKind.STALL)
    device.clear(FaultKind.STALL)
    device.clear(FaultKind.DROP)
    assert device.told == ["begin stall inf", "end stall"]


@pytest.mark.nightly
def test_a_cleared_fault_does_not_end_twice(device: Recording) -> None:
    device.apply(Fault(FaultKind.DROP, SHORT_S))
    device.clear(FaultKind.DROP)
    device.apply(Fault(FaultKind.STALL, 2 * SHORT_S))
    wait_until(lambda: device.told[-1] == "end stall")
    assert device.told == ["begin drop 0.05", "end drop", "begin stall 0.1", "end stall"]


def test_a_fault_that_comes_again_ends_first(device: Recording) -> None:
    for seconds in (10.0, 20.0):
        device.apply(Fault(FaultKind.OFF_BODY, seconds))
    assert device.told == ["begin off_body 10", "end off_body", "begin off_body 20"]


def test_different_faults_do_not_end_each_other(device: Recording) -> None:
    device.apply(Fault(FaultKind.DROP, inf))
    device.apply(Fault(FaultKind.OFF_BODY, inf))
    device.clear(FaultKind.DROP)
    assert device.told == ["begin drop inf", "begin off_body inf", "end drop"]


@pytest.mark.nightly
@pytest.mark.parametrize("kind", [FaultKind.LOW_BATTERY, FaultKind.DRIFT, FaultKind.GARBAGE])
def test_what_acts_at_once_has_no_end(device: Recording, kind: FaultKind) -> None:
    device.apply(Fault(kind, 0.0))
    device.apply(Fault(FaultKind.DROP, SHORT_S))
    wait_until(lambda: device.told[-1] == "end drop")
    device.clear(kind)
    assert device.told == [f"begin {kind.value} 0", "begin drop 0.05", "end drop"]


@pytest.mark.nightly
def test_late_answers_last_longer_than_they_are_late(
    device: Recording, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(virtual_device, "LATE_LASTS_S", 2 * SHORT_S)
    device.apply(Fault(FaultKind.LATE, 3600.0))
    wait_until(lambda: device.told == ["begin late 3600", "end late"])


def test_a_device_has_no_faults_but_its_own(device: Recording) -> None:
    refusal = Fault(FaultKind.REFUSE, 1.0)
    with pytest.raises(ValueError, match="recording cannot have the fault refuse"):
        device.apply(refusal)
    with pytest.raises(ValueError, match="recording cannot have the fault refuse"):
        device.schedule(refusal, 0.0)
    assert device.told == []


@pytest.mark.seam
def test_a_virtual_device_that_is_dropped_streams_again(tmp_path: Path) -> None:
    def polar() -> dict[str, Any]:
        with contextlib.suppress(ConfigError):
            (device,) = status_file.read_status(tmp_path)["devices"]
            return device
        return {}

    def pushed() -> int:
        return sum(counters["pushed"] for counters in polar().get("streams", {}).values())

    with cli_process(
        tmp_path, "run", "--simulate", "polar_h10", "--fault", "drop:3s@8s"
    ) as process:
        wait_until(lambda: pushed() > 0)
        wait_until(lambda: polar().get("connections") == 2)
        before = pushed()
        wait_until(lambda: polar().get("state") == "streaming" and pushed() > before)
        assert process.poll() is None
    lines = (tmp_path / LOG_FILE_NAME).read_text(encoding="utf-8").splitlines()
    records = [json.loads(line) for line in lines]
    said = [record for record in records if record.get("reason") == "lost"]
    assert [(record["sensor"], record["level"]) for record in said] == [("polar_h10", "warning")]


def test_a_device_has_the_faults_that_it_says_what_they_do() -> None:
    assert Recording.faults == frozenset(FaultKind) - {FaultKind.REFUSE}
    assert VirtualDevice.faults == frozenset()


def test_a_fault_that_lasts_must_have_an_end() -> None:
    with pytest.raises(TypeError, match="Endless has no end for the faults stall"):
        type("Endless", (Recording,), {"effects": {FaultKind.STALL: Effect(Recording.stall)}})


@pytest.mark.parametrize(
    "text", ["dropp:5s@10s", "polar_h10:dropp@3", "Drop@3", "polar_h10:drpo:5s@1"]
)
def test_a_misspelt_kind_of_fault_is_guessed(text: str) -> None:
    with pytest.raises(ConfigError, match=r"\(did you mean 'drop'\?\); write"):
        parse_fault(text)


TEXT = """
[lsl]
session_id = "lab7"
known_peers = ["192.168.1.20"]

[log]
level = "warning"

[power]
keep_awake = false

[events]
heartbeat_s = 2.5

[markers]
buttons = ["eyes open"]

[[device]]
sensor = "zephyr"
unit = "1"
port = "/dev/ttyUSB0"
"""


@pytest.fixture
def started(monkeypatch: pytest.MonkeyPatch) -> list[GatewaySettings]:
    """The settings of each agent that would run."""
    settings: list[GatewaySettings] = []

    def note(loaded: GatewaySettings, *_: Any, **__: Any) -> None:
        settings.append(loaded)

    monkeypatch.setattr(agent_process, "_run_agent", note)
    return settings


@pytest.mark.usefixtures("state")
@pytest.mark.parametrize("is_named", [False, True])
def test_all_but_the_devices_is_of_the_settings(
    run: Run, started: list[GatewaySettings], settings: Path, tmp_path: Path, is_named: bool
) -> None:
    file = tmp_path / "other.toml" if is_named else settings
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(TEXT)
    options = ("--settings", str(file)) if is_named else ()
    outcome = run("run", "--no-ask", "--simulate", "polar_h10", *options)
    assert outcome.code == 0, outcome.err
    (loaded,) = started
    assert (loaded.lsl.session_id, loaded.lsl.known_peers) == ("lab7", ("192.168.1.20",))
    assert (loaded.log.level, loaded.power.keep_awake) == ("warning", False)
    assert (loaded.events.heartbeat_s, loaded.markers.buttons) == (2.5, ("eyes open",))
    assert [each.sensor for each in loaded.devices] == ["polar_h10"]


@pytest.mark.usefixtures("state", "settings")
def test_no_settings_are_needed(
    run: Run, started: list[GatewaySettings], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("BIOSENSOR_GATEWAY_LSL__SESSION_ID", "lab8")
    assert run("run", "--no-ask", "--simulate", "polar_h10").code == 0
    assert started[0].lsl.session_id == "lab8"


@pytest.mark.usefixtures("state")
def test_wrong_settings_are_named(run: Run, started: list[GatewaySettings], settings: Path) -> None:
    settings.parent.mkdir(parents=True)
    settings.write_text('[lsl]\nsession = "lab7"\n')
    outcome = run("run", "--no-ask", "--simulate", "polar_h10")
    assert (outcome.code, started) == (2, [])
    assert f"{settings}, line 2" in outcome.err


def test_the_node_of_the_demo_is_in_the_agents_session(settings: Path) -> None:
    settings.parent.mkdir(parents=True)
    settings.write_text(TEXT.replace("lab7", "42"))
    node = demonstration.node_command()
    assert 'session_id:="42"' in node
    assert 'known_peers:=["192.168.1.20"]' in node
