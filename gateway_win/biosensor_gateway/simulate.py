"""Virtual devices in place of real ones: the only module that runs simulators.

A virtual device speaks the vendor's protocol on a real transport; the drivers
do not know the difference.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager

from biosensor_common.errors import ConfigError, ConfigReason
from biosensor_gateway.devices.zephyr.driver import ZephyrSettings
from biosensor_gateway.devices.zephyr.simulator.bioharness import SimulatedBioHarness
from biosensor_gateway.devices.zephyr.simulator.recording import RecordedSource
from biosensor_gateway.devices.zephyr.simulator.sources import SyntheticSource
from biosensor_gateway.settings import DeviceSettings, GatewaySettings, environment_overrides

ALL = "all"
# A virtual device may run for days; nobody asks this one what it has sent.
_KEPT_PACKETS = 0


@contextmanager
def _zephyr() -> Generator[DeviceSettings]:
    with SimulatedBioHarness(SyntheticSource(), kept_packets=_KEPT_PACKETS) as device:
        yield ZephyrSettings(sensor="zephyr", unit="virtual", port=device.port)


@contextmanager
def _zephyr_recording() -> Generator[DeviceSettings]:
    source = RecordedSource.shipped(on_end="hang_up")
    with SimulatedBioHarness(source, kept_packets=_KEPT_PACKETS) as device:
        yield ZephyrSettings(sensor="zephyr", unit="recording", port=device.port)


_DEVICES: dict[str, Callable[[], AbstractContextManager[DeviceSettings]]] = {
    "zephyr": _zephyr,
    # Real bytes of a BioHarness 3 instead of a made-up signal; it starts over after 150 s.
    "zephyr:recording": _zephyr_recording,
}


@contextmanager
def simulated_settings(names: Sequence[str]) -> Generator[GatewaySettings]:
    """Start virtual devices and yield settings in which they are the only ones.

    Parameters
    ----------
    names
        Sensors, as ``zephyr`` or ``zephyr:recording``; ``all`` for one of each sensor.
        What is named twice runs once.

    Raises
    ------
    ConfigError
        ``WRONG_VALUE``, for a name that has no virtual device.
    """
    sensors = [name for name in _DEVICES if ":" not in name]
    # Two of a name would be two streams of one source_id.
    wanted = dict.fromkeys(each for name in names for each in (sensors if name == ALL else [name]))
    with ExitStack() as running:
        devices = tuple(running.enter_context(_device(name)) for name in wanted)
        yield GatewaySettings.model_validate({**environment_overrides(), "device": devices})


def _device(name: str) -> AbstractContextManager[DeviceSettings]:
    if name not in _DEVICES:
        message = f"there is no virtual {name!r}; there are {', '.join(_DEVICES)} and {ALL}"
        raise ConfigError(ConfigReason.WRONG_VALUE, message)
    return _DEVICES[name]()
