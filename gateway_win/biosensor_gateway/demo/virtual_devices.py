"""Virtual devices in place of real ones: the only module that runs simulators.

A virtual device speaks the vendor's protocol on a real transport; the drivers
do not know the difference.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Generator, Iterable, Sequence
from contextlib import ExitStack, contextmanager
from functools import cached_property
from typing import TYPE_CHECKING

from biosensor_common.errors import ConfigError, ConfigReason
from biosensor_gateway.devices import driver
from biosensor_gateway.settings.models import DeviceSettings, GatewaySettings, environment_overrides
from biosensor_gateway.simulation.faults import Fault, ScheduledFault, parse_fault
from biosensor_gateway.simulation.twin import Twin
from biosensor_gateway.simulation.world import World

if TYPE_CHECKING:
    from biosensor_gateway.simulation.radio import Radio

ALL = "all"
# A virtual device may run for days; nobody asks this one what it has sent.
_KEPT = 0


class Scene:
    """Where virtual devices are: their world, and the air between Bluetooth ones."""

    def __init__(self, stack: ExitStack) -> None:
        self._stack = stack
        self.world = stack.enter_context(World())

    @cached_property
    def radio(self) -> Radio:
        """The air; this process's Bluetooth is virtual from the first use on."""
        # Their imports take half a second, which devices without a radio need not pay.
        from biosensor_gateway.simulation.bleak_backend import virtual_bluetooth  # noqa: PLC0415
        from biosensor_gateway.simulation.radio import Radio  # noqa: PLC0415

        radio = Radio(self.world)
        self._stack.enter_context(virtual_bluetooth(radio))
        return radio


def _empatica_e4(scene: Scene) -> Twin:
    from biosensor_gateway.devices.empatica_e4.simulator import SimulatedE4  # noqa: PLC0415

    return SimulatedE4(scene.world, kept=_KEPT)


def _emotiv_insight(scene: Scene) -> Twin:
    from biosensor_gateway.devices.emotiv_insight.simulator import SimulatedCortex  # noqa: PLC0415

    return SimulatedCortex(scene.world, kept=_KEPT)


def _shimmer3_gsr(scene: Scene) -> Twin:
    from biosensor_gateway.devices.shimmer3_gsr.simulator import SimulatedShimmer3  # noqa: PLC0415

    return SimulatedShimmer3(scene.world, kept=_KEPT)


def _polar_h10(scene: Scene) -> Twin:
    from biosensor_gateway.devices.polar_h10.simulator import SimulatedPolarH10  # noqa: PLC0415

    return SimulatedPolarH10(scene.world, scene.radio, kept=_KEPT)


def _vernier_respiration_belt(scene: Scene) -> Twin:
    from biosensor_gateway.devices.vernier_respiration_belt.simulator import (  # noqa: PLC0415
        SimulatedBelt,
    )

    return SimulatedBelt(scene.world, scene.radio, kept=_KEPT)


def _zephyr(scene: Scene) -> Twin:
    from biosensor_gateway.devices.zephyr.simulator import SimulatedZephyr  # noqa: PLC0415

    return SimulatedZephyr(scene.world, kept=_KEPT)


def _zephyr_recording(scene: Scene) -> Twin:
    from biosensor_gateway.devices.zephyr.simulator import RecordedZephyr  # noqa: PLC0415

    return RecordedZephyr(scene.world, kept=_KEPT)


def _ble_heart_rate(scene: Scene) -> Twin:
    from biosensor_gateway.devices.ble_heart_rate.simulator import (  # noqa: PLC0415
        SimulatedHeartRateStrap,
    )

    return SimulatedHeartRateStrap(scene.world, scene.radio, kept=_KEPT)


_TWINS: dict[str, Callable[[Scene], Twin]] = {
    "empatica_e4": _empatica_e4,
    "emotiv_insight": _emotiv_insight,
    "shimmer3_gsr": _shimmer3_gsr,
    "polar_h10": _polar_h10,
    "vernier_respiration_belt": _vernier_respiration_belt,
    "zephyr": _zephyr,
    # Real bytes of a BioHarness 3 instead of a made-up signal; it starts over after 150 s.
    "zephyr:recording": _zephyr_recording,
    "ble_heart_rate": _ble_heart_rate,
}


@contextmanager
def simulated_settings(
    names: Sequence[str], faults: Iterable[str] = ()
) -> Generator[GatewaySettings]:
    """Start virtual devices and yield settings in which they are the only ones.

    Parameters
    ----------
    names
        Sensors, as ``zephyr`` or ``zephyr:recording``; ``all`` for one of each sensor.
        What is named twice runs once.
    faults
        What goes wrong and when, as `parse_fault` reads it.

    Raises
    ------
    ConfigError
        ``WRONG_VALUE``, for a name that has no virtual device, and for a fault that
        none of them can have.
    """
    scheduled = [parse_fault(text) for text in faults]
    sensors = [name for name in _TWINS if ":" not in name]
    # Two of a name would be two streams of one source_id.
    wanted = dict.fromkeys(each for name in names for each in (sensors if name == ALL else [name]))
    for name in wanted:
        if name not in _TWINS:
            message = f"there is no virtual {name!r}; there are {', '.join(_TWINS)} and {ALL}"
            raise ConfigError(ConfigReason.WRONG_VALUE, message)
    with ExitStack() as stack:
        scene = Scene(stack)
        twins = {name: stack.enter_context(_twin(name, scene)) for name in wanted}
        _schedule(scheduled, twins)
        stack.enter_context(_environment(twins.values()))
        devices = tuple(_settings(name, twin) for name, twin in twins.items())
        yield GatewaySettings.model_validate({**environment_overrides(), "device": devices})


def _twin(name: str, scene: Scene) -> Twin:
    try:
        return _TWINS[name](scene)
    except ModuleNotFoundError as error:
        message = (
            f"the virtual {name} needs {error.name}, which is not installed; "
            "run: pip install 'biosensor-gateway[simulate]'"
        )
        raise ConfigError(ConfigReason.NOT_FOUND, message) from error


def _settings(name: str, twin: Twin) -> DeviceSettings:
    _, _, variant = name.partition(":")
    fields = {"sensor": twin.sensor, "unit": variant or "virtual", **twin.settings}
    return driver(twin.sensor).settings.model_validate(fields)


def _schedule(scheduled: Iterable[ScheduledFault], twins: dict[str, Twin]) -> None:
    for each in scheduled:
        hit = [
            twin
            for name, twin in twins.items()
            if each.sensor in ("", name) and each.fault.kind in twin.faults
        ]
        if not hit:
            whom = each.sensor or "none of the virtual devices"
            message = f"{whom} cannot have the fault {each.fault.kind.value}"
            raise ConfigError(ConfigReason.WRONG_VALUE, message)
        for twin in hit:
            twin.schedule(Fault(each.fault.kind, each.fault.value), each.start_s)


@contextmanager
def _environment(twins: Iterable[Twin]) -> Generator[None]:
    """Set what drivers look up in the environment: credentials of virtual services."""
    wanted = {key: value for twin in twins for key, value in twin.environment.items()}
    before = {key: os.environ.get(key) for key in wanted}
    os.environ.update(wanted)
    try:
        yield
    finally:
        for key, value in before.items():
            if value is None:
                os.environ.pop(key, None)
            else:
                os.environ[key] = value
