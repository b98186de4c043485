import subprocess
import sys
from collections.abc import Callable
from importlib import invalidate_caches
from pathlib import Path

import pytest

from biosensor_common.errors import SpecError, SpecReason
from biosensor_common.spec import SensorSpec
from biosensor_gateway import devices
from biosensor_gateway.devices.registry import (
    ENTRY_POINT_GROUP,
    declaration,
    declaration_names,
    driver,
    sensor,
    sensor_names,
)

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
    inside = {name.split(".")[3] for name in loaded if name.count(".") > 2}
    assert inside == {"declaration"}


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
