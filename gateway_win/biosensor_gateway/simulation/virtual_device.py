"""Base class of all virtual devices: power, faults and truth."""

from __future__ import annotations

import asyncio
from abc import ABC, abstractmethod
from collections.abc import Mapping
from enum import Enum, unique
from math import isfinite
from types import MappingProxyType
from typing import Any, ClassVar, NamedTuple, Self, TypedDict, Unpack

from biosensor_gateway.simulation.faults import Effects, Fault, FaultKind, Kind, Untidiness
from biosensor_gateway.simulation.truth import USUALLY_IMPOSSIBLE, Expected, Truth
from biosensor_gateway.simulation.wearer import Wearer
from biosensor_gateway.simulation.world import World

_IN_ORDER = "its transport keeps the order of bytes"
_HELD_BY_HOST = "only the computer can delay its bytes for seconds, for example while asleep"
_NO_NAME = "it is not found by a name on the radio"
_NO_ADDRESS = "its settings contain its address, so nothing searches for it by radio"


@unique
class Link(Enum):
    """Kind of link between a device and its driver."""

    BLUETOOTH_LE = "Bluetooth LE"
    SERIAL = "a serial port"
    """Includes Bluetooth Classic."""
    TCP = "TCP"
    WEB_SOCKET = "a WebSocket"
    UDP = "UDP"


IMPOSSIBLE: Mapping[Link, Mapping[Kind, str]] = MappingProxyType(
    {
        Link.BLUETOOTH_LE: {
            Untidiness.OVERTAKEN: "a link of Bluetooth LE repeats a packet until it is "
            "acknowledged, before it sends the next one",
            Untidiness.GLUED: "a notification arrives whole and separately",
        },
        Link.SERIAL: {
            Untidiness.BUNDLED: _HELD_BY_HOST,
            Untidiness.OVERTAKEN: _IN_ORDER,
            Untidiness.NAMELESS: _NO_NAME,
            Untidiness.READDRESSED: _NO_ADDRESS,
        },
        Link.TCP: {
            Untidiness.BUNDLED: _HELD_BY_HOST,
            Untidiness.OVERTAKEN: _IN_ORDER,
            Untidiness.NAMELESS: _NO_NAME,
            Untidiness.READDRESSED: _NO_ADDRESS,
        },
        Link.WEB_SOCKET: {
            Untidiness.BUNDLED: _HELD_BY_HOST,
            Untidiness.OVERTAKEN: _IN_ORDER,
            Untidiness.GLUED: "a WebSocket message arrives whole and separately",
            Untidiness.NAMELESS: _NO_NAME,
            Untidiness.READDRESSED: _NO_ADDRESS,
        },
        Link.UDP: {
            Untidiness.BUNDLED: _HELD_BY_HOST,
            Untidiness.GLUED: "a datagram arrives whole and separately",
            Untidiness.NAMELESS: _NO_NAME,
            Untidiness.READDRESSED: "its data contains its identity, whatever the address",
        },
    }
)
"""Faults that are impossible with each link, with reasons."""


class SpecimenOptions(TypedDict, total=False):
    """The parameters of `Specimen`, for constructors that pass them on."""

    wearer: Wearer | None
    seed: int
    drift_ppm: float
    jitter_s: float
    kept: int | None


class Specimen:
    """The individual properties of a device: its wearer and its imperfections.

    Parameters
    ----------
    wearer
        The wearer; by default created from ``seed``.
    seed
        Seed of delays and garbage.
    drift_ppm
        Initial drift of its oscillator, positive for fast [ppm].
    jitter_s
        Maximum delay of sent data [s].
    kept
        Limit of its truth [samples per stream]; None for no limit.
    """

    __slots__ = ("drift_ppm", "jitter_s", "kept", "seed", "wearer")

    def __init__(
        self,
        *,
        wearer: Wearer | None = None,
        seed: int = 0,
        drift_ppm: float = 0.0,
        jitter_s: float = 0.0,
        kept: int | None = None,
    ) -> None:
        self.wearer = wearer or Wearer(seed)
        self.seed = seed
        self.drift_ppm = drift_ppm
        self.jitter_s = jitter_s
        self.kept = kept


LATE_LASTS_S = 30.0
_AT_ONCE: frozenset[Kind] = frozenset(
    {
        FaultKind.LOW_BATTERY,
        FaultKind.DRIFT,
        FaultKind.GARBAGE,
        FaultKind.FORGET,
        FaultKind.STEP_BACK,
        Untidiness.STRAY,
    }
)
# Faults whose value is not their duration.
_OF_FIXED_LENGTH: frozenset[Kind] = frozenset(
    {FaultKind.LATE, Untidiness.RATE, Untidiness.PACE, Untidiness.BUNDLED}
)


class Filled(NamedTuple):
    """When a stream has its first data, if not within the first second."""

    after_s: float | None  # Seconds from the connection to its first sample; None for never.
    reason: str  # Why not earlier, or never; a clause for the user.


class VirtualDevice(ABC):
    """A virtual device in a world's event loop; a context manager.

    Public methods may be called from any thread except the world's, and return when they have
    finished. A subclass implements the private methods and the functions in its `effects`, which
    run in the world's event loop.

    Parameters
    ----------
    **specimen
        Parameters of its `Specimen`.
    """

    sensor: ClassVar[str]
    """Name of the sensor."""
    effects: ClassVar[Effects[Any]] = MappingProxyType({})
    """Effects of its possible faults; those with a duration have an `end`."""
    faults: ClassVar[frozenset[FaultKind]] = frozenset()
    """Its possible faults: those in `effects` without disturbances."""
    link: ClassVar[Link]
    """Kind of link."""
    on_air: ClassVar[bool] = False
    """Whether its constructor also takes a :class:`~biosensor_gateway.simulation.radio.Radio`."""
    only_advertises: ClassVar[bool] = False
    """Whether it only sends data in advertisements, so hosts do not connect."""
    filled: ClassVar[Mapping[str, Filled]] = MappingProxyType({})
    """Streams that start late, by data name; all others start at once."""
    rates_hz: ClassVar[Mapping[str, float]] = MappingProxyType({})
    """Rates that the device reports when connected, by data name."""
    each_own: ClassVar[Mapping[str, str]] = MappingProxyType({})
    """Constructor options that differ between devices, with placeholders for their number."""
    expected: ClassVar[Expected] = Expected()
    """What an agent can know about it."""
    device: str
    """Its name, number or address, if its settings need nothing else."""

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        if cls.on_air:
            cls.link = Link.BLUETOOTH_LE
        endless = [
            kind.value
            for kind, effect in cls.effects.items()
            if effect.end is None and kind not in _AT_ONCE
        ]
        if endless:
            raise TypeError(f"{cls.__name__} has no end for the faults {', '.join(endless)}")
        cls.faults = frozenset(kind for kind in cls.effects if isinstance(kind, FaultKind))

    def __init__(self, world: World, **specimen: Unpack[SpecimenOptions]) -> None:
        self.world = world
        self.specimen = Specimen(**specimen)  # Its wearer and its imperfections.
        self.truth = Truth(self.specimen.kept)  # Record of what it measured and sent.
        self._lasting: dict[Kind, asyncio.TimerHandle | None] = {}

    @classmethod
    def worn_by(cls, wearer: Wearer, number: int) -> Mapping[str, object]:
        """Return the constructor options for a person's device.

        Parameters
        ----------
        number
            Number of existing devices of its kind, which makes it distinguishable.
        """
        own = {
            name: form.format(number=number, next=number + 1) for name, form in cls.each_own.items()
        }
        return {"wearer": wearer, "seed": number, **own}

    @classmethod
    def impossible(cls) -> Mapping[Kind, str]:
        """Return why the real device cannot have certain faults, by fault."""
        usual = {**USUALLY_IMPOSSIBLE, **IMPOSSIBLE[cls.link]}
        others = {kind: why for kind, why in usual.items() if kind not in cls.effects}
        return {**others, **cls.expected.impossible}

    @property
    def settings(self) -> Mapping[str, Any]:
        """Settings with which a driver finds it, after the start."""
        return {"device": self.device}

    @property
    def environment(self) -> Mapping[str, str]:
        """Environment variables for a driver, such as a virtual service's credentials."""
        return {}

    def __enter__(self) -> Self:
        self.world.await_(self._start())
        return self

    def __exit__(self, *_: object) -> None:
        self.world.await_(self._stop())

    def apply(self, fault: Fault) -> None:
        """Start a fault; one with a duration ends by itself or with `clear`.

        Raises
        ------
        ValueError
            If this device cannot have this fault.
        """
        self._require(fault)
        self.world.call(lambda: self._apply(fault))

    def schedule(self, fault: Fault, after_s: float) -> None:
        """Start a fault after a delay.

        Raises
        ------
        ValueError
            If this device cannot have this fault.
        """
        self._require(fault)
        self.world.call(lambda: self.world.loop.call_later(after_s, self._apply, fault))

    def clear(self, kind: Kind) -> None:
        """End a fault now, if it is active."""
        self.world.call(lambda: self._clear(kind))

    def _require(self, fault: Fault) -> None:
        if fault.kind not in self.effects:
            raise ValueError(f"{self.sensor} cannot have the fault {fault.kind.value}")

    def _apply(self, fault: Fault) -> None:
        self._clear(fault.kind)
        self.effects[fault.kind].begin(self, fault.value)
        if fault.kind in _AT_ONCE:
            return
        seconds = LATE_LASTS_S if fault.kind in _OF_FIXED_LENGTH else fault.value
        self._lasting[fault.kind] = (
            self.world.loop.call_later(seconds, self._clear, fault.kind)
            if isfinite(seconds)
            else None
        )

    def _clear(self, kind: Kind) -> None:
        if kind not in self._lasting:
            return
        timer = self._lasting.pop(kind)
        if timer is not None:
            timer.cancel()
        end = self.effects[kind].end
        if end is not None:
            end(self)

    @abstractmethod
    async def _start(self) -> None:
        """Switch the device on, so that it can be found and connected."""

    @abstractmethod
    async def _stop(self) -> None:
        """Switch the device off."""
