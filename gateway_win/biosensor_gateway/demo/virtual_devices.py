"""Starts virtual devices instead of real ones: the only module that imports simulators.

A virtual device speaks the vendor's protocol on a real transport, so that drivers run
unchanged.
"""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import replace
from functools import cached_property
from importlib import import_module
from itertools import chain
from pkgutil import resolve_name
from typing import TYPE_CHECKING, Any, NamedTuple, cast

from biosensor_common.errors import ConfigError, ConfigReason, SpecError, SpecReason, did_you_mean
from biosensor_common.naming import require_participant
from biosensor_common.quantities import ContentType
from biosensor_gateway.devices.registry import driver, sensor, sensor_names
from biosensor_gateway.settings.models import DeviceSettings, GatewaySettings
from biosensor_gateway.simulation.faults import (
    Fault,
    FaultKind,
    OfWearer,
    ScheduledFault,
    parse_fault,
)
from biosensor_gateway.simulation.virtual_device import VirtualDevice
from biosensor_gateway.simulation.wearer import Wearer, someone
from biosensor_gateway.simulation.world import World
from biosensor_gateway.system.device_log import wearers_in_log

if TYPE_CHECKING:
    from biosensor_gateway.simulation.radio import Radio

ALL = "all"
_WORN_BY = "@"
_OF_HEART = frozenset({ContentType.HR, ContentType.RR, ContentType.ECG, ContentType.PPG})
# What a virtual device has sent is not stored here, because it may run for days.
_KEPT = 0


class Wanted(NamedTuple):
    """A requested virtual device."""

    name: str  # `zephyr` or `zephyr:recording`.
    participant: str = ""  # The wearer; empty for none in particular.


class Scene:
    """The world of virtual devices, and the radio of those with Bluetooth."""

    def __init__(self, stack: ExitStack) -> None:
        self._stack = stack
        self.world = stack.enter_context(World())

    @cached_property
    def radio(self) -> Radio:
        """The radio; from its first use on, this process's Bluetooth is virtual."""
        # Imported here, because it takes half a second, and devices without a radio do not need it.
        from biosensor_gateway.simulation.bleak_backend import virtual_bluetooth  # noqa: PLC0415
        from biosensor_gateway.simulation.radio import Radio  # noqa: PLC0415

        radio = Radio(self.world)
        self._stack.enter_context(virtual_bluetooth(radio))
        return radio


def virtual_names() -> tuple[str, ...]:
    """Return the names of all virtual devices, such as ``zephyr`` and ``zephyr:recording``."""
    return tuple(
        f"{name}:{variant}" if variant else name
        for name in sensor_names()
        for variant in sensor(name).virtual
    )


def one_of_each() -> tuple[str, ...]:
    """Return the names that ``all`` stands for: the sensors with a default virtual device."""
    return tuple(name for name in virtual_names() if ":" not in name)


def virtual_class(name: str) -> type[VirtualDevice]:
    """Import the class of a virtual device.

    Raises
    ------
    ConfigError
        ``WRONG_VALUE`` if there is none with that name; ``NOT_FOUND`` if it needs a
        library that is missing.
    SpecError
        ``INVALID`` if the class that another package names is not a virtual device.
    """
    place = _place(name)
    try:
        found: object = resolve_name(place)
    except ModuleNotFoundError as error:
        message = (
            f"the virtual {name} needs {error.name}, which is not installed; "
            "run: pip install --upgrade --force-reinstall biosensor-gateway"
        )
        raise ConfigError(ConfigReason.NOT_FOUND, message) from error
    if not (isinstance(found, type) and issubclass(found, VirtualDevice)):
        raise SpecError(SpecReason.INVALID, f"The virtual {name}, {place}, is not a VirtualDevice.")
    return found


def _place(name: str) -> str:
    """Return the import path of a virtual device, without listing all of them, which is slow."""
    sensor_name, colon, variant = name.partition(":")
    with suppress(KeyError):
        if variant or not colon:
            return _virtual_of(sensor_name)[variant]
    known = virtual_names()
    message = (
        f"there is no virtual {name!r}{did_you_mean(name, known)}; there are {', '.join(known)} "
        f"and {ALL}"
    )
    raise ConfigError(ConfigReason.WRONG_VALUE, message)


def _virtual_of(sensor_name: str) -> Mapping[str, str]:
    try:
        return sensor(sensor_name).virtual
    except SpecError as error:
        if error.reason is SpecReason.UNKNOWN_SENSOR:
            return {}
        raise


def import_all(names: Iterable[str]) -> None:
    """Import the modules that `simulated_settings` needs for these names, and start nothing.

    Raises
    ------
    ConfigError, SpecError
        As for :func:`virtual_class`.
    """
    if any(virtual_class(each.name).on_air for each in _each(names)):
        import_module("biosensor_gateway.simulation.bleak_backend")


def _each(names: Iterable[str]) -> tuple[Wanted, ...]:
    """Return the requested devices, each once, because two would share their source_ids."""
    typed = map(_wanted, names)
    expanded = (
        (Wanted(each, wanted.participant) for each in one_of_each())
        if wanted.name == ALL
        else (wanted,)
        for wanted in typed
    )
    return tuple(dict.fromkeys(chain.from_iterable(expanded)))


def _wanted(text: str) -> Wanted:
    name, worn, participant = text.partition(_WORN_BY)
    if worn and not participant:
        message = f"{text!r} names nobody; write {text}P01, or leave out the {_WORN_BY}"
        raise ConfigError(ConfigReason.WRONG_VALUE, message)
    return Wanted(name, participant)


def _start(
    wanted: Sequence[Wanted], of_wearers: Sequence[ScheduledFault], stack: ExitStack
) -> dict[Wanted, VirtualDevice]:
    """Start devices: those of one participant on one wearer, those of a kind in other places."""
    turns = turns_of(wanted, [e for e in of_wearers if e.fault.kind is OfWearer.HEART_RATE])
    flat = _flat(wanted, [each for each in of_wearers if each.fault.kind is OfWearer.FLAT])
    scene = Scene(stack)
    people = list(dict.fromkeys(each.participant for each in wanted))
    kinds: Counter[str] = Counter()
    devices: dict[Wanted, VirtualDevice] = {}
    for each in wanted:
        options: Mapping[str, object] = {}
        changes: dict[str, Any] = {"turns": turns[each], "flat": flat[each]}
        if each.participant:
            wearer = replace(someone(people.index(each.participant)), **changes)
            options = virtual_class(each.name).worn_by(wearer, kinds[each.name])
        elif turns[each] or flat[each]:
            options = virtual_class(each.name).worn_by(Wearer(**changes), 0)
        kinds[each.name] += 1
        device = make(each.name, scene, kept=_KEPT, **options)
        devices[each] = stack.enter_context(device)
    return devices


def _flat(
    wanted: Sequence[Wanted], scheduled: Iterable[ScheduledFault]
) -> dict[Wanted, tuple[tuple[float, float], ...]]:
    """Return the periods in which the values of each device are constant.

    Raises
    ------
    ConfigError
        ``WRONG_VALUE`` if the named device is not there.
    """
    flat: dict[Wanted, tuple[tuple[float, float], ...]] = dict.fromkeys(wanted, ())
    for each in scheduled:
        hit = [one for one in wanted if each.sensor in ("", one.name)]
        if not hit:
            raise _cannot_have(each)
        for one in hit:
            flat[one] += ((each.start_s, each.start_s + each.fault.value),)
    return flat


def turns_of(
    wanted: Sequence[Wanted], hearts: Iterable[ScheduledFault]
) -> dict[Wanted, tuple[tuple[float, float], ...]]:
    """Return the changes of the wearer's heart rate for each device.

    Devices of one participant have the same changes.

    Raises
    ------
    ConfigError
        ``WRONG_VALUE`` if the named device, or none of the devices, measures a heart.
    """
    turns: dict[Wanted, tuple[tuple[float, float], ...]] = dict.fromkeys(wanted, ())
    for each in hearts:
        hit = [one for one in wanted if each.sensor in ("", one.name) and _has_heart(one.name)]
        if not hit:
            raise _cannot_have(each)
        people = {one.participant for one in hit if one.participant}
        for one in wanted:
            if one in hit or one.participant in people:
                turns[one] += ((each.start_s, each.fault.value),)
    return turns


def _has_heart(name: str) -> bool:
    """Whether a device measures a heart and has a wearer; a recording has none."""
    kinds = {stream.content_type for stream in sensor(name.partition(":")[0]).spec.streams}
    return FaultKind.OFF_BODY in virtual_class(name).faults and not kinds.isdisjoint(_OF_HEART)


def make(name: str, scene: Scene, /, **options: object) -> VirtualDevice:
    """Make a virtual device without starting it.

    Raises
    ------
    ConfigError, SpecError
        As for :func:`virtual_class`.
    """
    found = virtual_class(name)
    constructor = cast("Callable[..., VirtualDevice]", found)
    place: tuple[object, ...] = (scene.world, scene.radio) if found.on_air else (scene.world,)
    return constructor(*place, **options)


@contextmanager
def simulated_settings(
    names: Sequence[str], faults: Iterable[str] = (), settings: GatewaySettings | None = None
) -> Generator[GatewaySettings]:
    """Start virtual devices and yield settings in which they are the only ones.

    Parameters
    ----------
    names
        Sensors, as ``zephyr`` or ``zephyr:recording``; ``all`` for one of each sensor. With
        ``@P01`` after it, participant P01 wears it. A name that is given twice runs once.
    faults
        Faults with their times; see `parse_fault`.
    settings
        Settings whose devices are replaced; None for the defaults.

    Raises
    ------
    ConfigError
        ``WRONG_VALUE`` for a name without a virtual device, or for a fault that none of
        the devices can have.
    """
    scheduled = [parse_fault(text) for text in faults]
    wanted = _each(names)
    for each in wanted:
        virtual_class(each.name)
        if each.participant:
            require_participant(each.participant)
    with ExitStack() as stack:
        of_wearers = [each for each in scheduled if isinstance(each.fault.kind, OfWearer)]
        devices = _start(wanted, of_wearers, stack)
        _schedule((each for each in scheduled if each not in of_wearers), devices)
        stack.enter_context(_environment(devices.values()))
        stack.enter_context(wearers_in_log())
        tables = tuple(_settings(each, device) for each, device in devices.items())
        yield (settings or GatewaySettings()).model_copy(update={"devices": tables})


def _settings(wanted: Wanted, device: VirtualDevice) -> DeviceSettings:
    _, _, variant = wanted.name.partition(":")
    fields = {
        "sensor": device.sensor,
        "unit": variant or "virtual",
        "participant": wanted.participant,
        **device.settings,
    }
    return driver(device.sensor).settings.model_validate(fields)


def _schedule(scheduled: Iterable[ScheduledFault], devices: dict[Wanted, VirtualDevice]) -> None:
    for each in scheduled:
        hit = [
            device
            for wanted, device in devices.items()
            if each.sensor in ("", wanted.name) and each.fault.kind in device.effects
        ]
        if not hit:
            raise _cannot_have(each)
        for device in hit:
            device.schedule(Fault(each.fault.kind, each.fault.value), each.start_s)


def _cannot_have(scheduled: ScheduledFault) -> ConfigError:
    who = f"{scheduled.sensor} cannot" if scheduled.sensor else "none of the virtual devices can"
    message = f"{who} have the fault {scheduled.fault.kind.value}"
    return ConfigError(ConfigReason.WRONG_VALUE, message)


@contextmanager
def _environment(devices: Iterable[VirtualDevice]) -> Generator[None]:
    """Set environment variables with the credentials of virtual services."""
    wanted = {key: value for device in devices for key, value in device.environment.items()}
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
