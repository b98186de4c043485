import subprocess
import sys
from collections.abc import Callable
from importlib import invalidate_caches
from pathlib import Path

import pytest

from biosensor_common.errors import SpecError, SpecReason
from biosensor_common.registry import ENTRY_POINT_GROUP, sensor, sensor_names
from biosensor_common.spec import SensorSpec

Install = Callable[[str, dict[str, str]], None]

BUILT_IN = (
    "empatica_e4",
    "emotiv_insight",
    "shimmer3_gsr",
    "polar_h10",
    "vernier_respiration_belt",
    "zephyr",
    "ble_heart_rate",
    "gateway",
)
MODULE = """
from biosensor_common.spec import SensorSpec

BAND = SensorSpec("acme_band", "Acme Band", "Acme", "Band", ())
OTHER_NAME = SensorSpec("acme_ring", "Acme Ring", "Acme", "Ring", ())
ZEPHYR = SensorSpec("zephyr", "Not a Zephyr", "Acme", "Band", ())
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
        sensor(name)
    return caught.value


def modules_after(statements: str) -> set[str]:
    """Sensor modules that a fresh interpreter has loaded after *statements*."""
    script = f"""
import sys
{statements}
print(*[name for name in sys.modules if name.startswith("biosensor_common.sensors.")])
"""
    run = [sys.executable, "-c", script]
    return set(subprocess.run(run, capture_output=True, text=True, check=True).stdout.split())


@pytest.mark.parametrize("name", BUILT_IN)
def test_a_built_in_sensor_is_found_under_its_own_name(name: str) -> None:
    assert sensor(name).name == name


def test_all_built_in_sensors_are_listed() -> None:
    assert sensor_names()[: len(BUILT_IN)] == BUILT_IN


def test_an_unknown_sensor_is_refused_with_the_known_names() -> None:
    error = refusal("zephir")
    assert error.reason is SpecReason.UNKNOWN_SENSOR
    assert "'zephir'" in str(error)
    assert all(name in str(error) for name in BUILT_IN)


def test_no_sensor_is_imported_before_it_is_asked_for() -> None:
    assert modules_after("from biosensor_common.registry import sensor_names; sensor_names()") == (
        set()
    )


def test_asking_for_one_sensor_imports_no_other() -> None:
    loaded = modules_after("from biosensor_common.registry import sensor; sensor('zephyr')")
    assert loaded == {"biosensor_common.sensors.zephyr"}


def test_another_package_adds_a_sensor(install: Install) -> None:
    install("acme-sensors", {"acme_band": "acme_sensors:BAND"})
    assert sensor_names() == (*BUILT_IN, "acme_band")
    assert sensor("acme_band") == SensorSpec("acme_band", "Acme Band", "Acme", "Band", ())


@pytest.mark.parametrize(
    "value",
    [
        pytest.param("acme_missing:BAND", id="no such module"),
        pytest.param("acme_sensors:MISSING", id="no such attribute"),
        pytest.param("acme_crash:BAND", id="fails on import"),
        pytest.param("acme_sensors:NUMBER", id="not a SensorSpec"),
        pytest.param("acme_sensors:OTHER_NAME", id="another name"),
    ],
)
def test_a_broken_sensor_is_refused_with_its_package_and_harms_no_other(
    install: Install, value: str
) -> None:
    install("acme-sensors", {"acme_band": value, "zephyr_two": value})
    assert "acme_band" in sensor_names()
    assert sensor("zephyr").name == "zephyr"
    error = refusal("acme_band")
    assert error.reason is SpecReason.INVALID
    assert "acme-sensors" in str(error)
    assert "'acme_band'" in str(error)


def test_a_sensor_of_two_packages_is_refused_with_both(install: Install) -> None:
    install("acme-sensors", {"acme_band": "acme_sensors:BAND"})
    install("acme-clone", {"acme_band": "acme_sensors:BAND"})
    error = refusal("acme_band")
    assert error.reason is SpecReason.INVALID
    assert "acme-clone, acme-sensors" in str(error)
    assert sensor_names() == (*BUILT_IN, "acme_band")


def test_a_built_in_sensor_cannot_be_replaced(install: Install) -> None:
    install("acme-sensors", {"zephyr": "acme_sensors:ZEPHYR"})
    assert sensor("zephyr").title == "Zephyr BioHarness 3"
    assert sensor_names() == BUILT_IN
