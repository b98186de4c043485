"""A virtual Muse 2, with numbered packets and one characteristic per channel."""

from __future__ import annotations

import struct
from collections.abc import Callable, Coroutine, Iterable
from itertools import count
from types import MappingProxyType
from typing import NamedTuple, Unpack

import numpy as np

from biosensor_gateway.devices.muse.simulator.headband import (
    CLASSIC,
    Headband,
    HeadbandOptions,
    uuid,
)
from biosensor_gateway.simulation.faults import FaultKind, lasting
from biosensor_gateway.simulation.radio import Radio
from biosensor_gateway.simulation.virtual_device import Filled
from biosensor_gateway.simulation.wearer import Floats
from biosensor_gateway.simulation.world import World

_EEG_HZ, _LIGHT_HZ, _MOTION_HZ = 256.0, 64.0, 52.0
_TELEMETRY_S = 1.0
_WITH_AUX = frozenset({"p20", "p50", "p60"})
_WITH_LIGHT = frozenset({"p50", "p51", "p60", "p61"})
_SILENT = "it is switched off unless the settings ask"

Packets = list[tuple[str, bytes]]
Rows = dict[str, Floats]

# Sources: muse-lsl (`muse.py`), muse-js (`muse-parse.ts`) and BrainFlow (`muse.cpp`), which agree
# on 12 samples of 12 bits, 6 of 24 bits, 3 times 3 of 16 bits, and on their scales.
EEG_UUIDS = {"TP9": uuid(3), "AF7": uuid(4), "AF8": uuid(5), "TP10": uuid(6)}
AUX_UUID, GYRO_UUID, ACC_UUID, TELEMETRY_UUID = uuid(7), uuid(9), uuid(10), uuid(11)
LIGHT_UUIDS = {"ambient": uuid(15), "infrared": uuid(16), "red": uuid(17)}
EEG_COUNT, LIGHT_COUNT, MOTION_COUNT = 12, 6, 3
_UV, _G, _DPS = 0.48828125, 1 / 16384, 245 / 32768
_FULL_12, _FULL_24 = (1 << 12) - 1, (1 << 24) - 1


def _eeg_packet(number: int, microvolts: Floats) -> tuple[bytes, Floats]:
    """Return a packet of one electrode, and the values in it [uV]."""
    counts = np.clip(np.rint(microvolts / _UV) + 2048, 0, _FULL_12).astype(int)
    bits = 0
    for each in counts:
        bits = bits << 12 | int(each)
    return struct.pack(">H", number & 0xFFFF) + bits.to_bytes(18, "big"), (counts - 2048) * _UV


def _light_packet(number: int, values: Floats) -> tuple[bytes, Floats]:
    """Return a packet of one photodiode, and the values in it [counts]."""
    counts = np.clip(np.rint(values), 0, _FULL_24).astype(int)
    body = b"".join(int(count).to_bytes(3, "big") for count in counts)
    return struct.pack(">H", number & 0xFFFF) + body, counts.astype(float)


def _acceleration_packet(number: int, g: Floats) -> tuple[bytes, Floats]:
    """Return a packet of acceleration, and the values in it [g]."""
    return _motion(number, g, _G)


def _rotation_packet(number: int, degrees_per_s: Floats) -> tuple[bytes, Floats]:
    """Return a packet of rotation, and the values in it [deg/s]."""
    return _motion(number, degrees_per_s, _DPS)


def _telemetry_packet(number: int, percent: float) -> tuple[bytes, float]:
    """Return a packet of battery and temperature, and the battery level in it."""
    raw = round(percent * 512)
    fields = struct.pack(">HHHHH", number & 0xFFFF, raw, 1700, 3900, 25)
    return fields.ljust(20, b"\0"), raw / 512


def _motion(number: int, values: Floats, unit: float) -> tuple[bytes, Floats]:
    counts = np.clip(np.rint(values / unit), -32768, 32767).astype(">i2")
    return struct.pack(">H", number & 0xFFFF) + counts.tobytes(), counts * unit


class _Source(NamedTuple):
    """Channels that are measured together."""

    rate_hz: float
    samples: int
    # Takes the packet number and the true times; returns packets with their characteristics, and
    # samples by data name.
    measure: Callable[[int, Floats], tuple[Packets, Rows]]


class SimulatedMuse(Headband):
    """A Muse 2; see `Headband`.

    Parameters
    ----------
    motion_deviation
        Relative deviation of acceleration and rotation from 52 Hz.
    """

    expected = CLASSIC
    each_own = MappingProxyType(
        {"address": "00:55:DA:B0:3B:{number:02X}", "serial": "4021-3B{number:02X}-0002"}
    )
    effects = MappingProxyType(
        {**Headband.effects, FaultKind.DENY: lasting(Headband.deny, Headband.give)}
    )
    deniable = (TELEMETRY_UUID, EEG_UUIDS["AF8"], ACC_UUID, GYRO_UUID, LIGHT_UUIDS["red"])
    filled = MappingProxyType(
        {
            "aux": Filled(None, _SILENT),
            "optics": Filled(None, "a Muse S Athena alone has it"),
        }
    )
    kind = "Muse"
    protocol = 1
    start = "d"
    presets = frozenset({"p20", "p21", "p22", "p50", "p51", "p60", "p61"})
    usual = "00:55:DA:B0:3A:1F", "4021-3A1F-0001"
    sends_on = (
        *EEG_UUIDS.values(),
        AUX_UUID,
        GYRO_UUID,
        ACC_UUID,
        TELEMETRY_UUID,
        *LIGHT_UUIDS.values(),
    )

    def __init__(
        self,
        world: World,
        radio: Radio,
        *,
        motion_deviation: float = 0.0,
        **more: Unpack[HeadbandOptions],
    ) -> None:
        super().__init__(world, radio, **more)
        self._motion_hz = _MOTION_HZ * (1 + motion_deviation)

    def _streams(self) -> Iterable[Coroutine[None, None, None]]:
        yield self._send_all(_Source(_EEG_HZ, EEG_COUNT, self._eeg))
        for measure in (self._acceleration, self._rotation):
            yield self._send_all(_Source(self._motion_hz, MOTION_COUNT, measure))
        if self._preset in _WITH_LIGHT:
            yield self._send_all(_Source(_LIGHT_HZ, LIGHT_COUNT, self._light))
        yield self._tell_battery()

    async def _send_all(self, source: _Source) -> None:
        begin_s, left_s = self._oscillator.now(), 0.0
        for number in count():
            indices = number * source.samples + np.arange(source.samples)
            device_s = begin_s + indices / source.rate_hz
            measured_s = await self._oscillator.reach(float(device_s[-1]))
            times = np.array([self._oscillator.true_time(float(each)) for each in device_s])
            left_s = await self._leave(measured_s, left_s)
            values, rows = source.measure(number, times)
            heard = {uuid for uuid, _ in values if self._is_heard(uuid)}
            sent = [await self._notify(uuid, value) for uuid, value in values if uuid in heard]
            for name, samples in rows.items() if heard else ():
                self._note(name, times, samples, sent=all(sent))

    def _is_heard(self, uuid: str) -> bool:
        return self._peripheral.subscribed(self._characteristics[uuid])

    def _eeg(self, number: int, times: Floats) -> tuple[Packets, Rows]:
        values: Packets = []
        columns: list[Floats] = []
        for electrode, characteristic in EEG_UUIDS.items():
            data, held = _eeg_packet(number, self._signals.eeg_uv(times, electrode))
            values.append((characteristic, data))
            columns.append(held)
        rows = {"eeg": np.stack(columns, axis=1)}
        if self._preset in _WITH_AUX and self._is_heard(AUX_UUID):
            data, held = _eeg_packet(number, self._signals.eeg_uv(times, "AUX"))
            # The AUX packet is sent first, because handles are in reverse order.
            values.insert(0, (AUX_UUID, data))
            nothing = np.full((len(held), 3), np.nan)
            rows["aux"] = np.concatenate((held[:, np.newaxis], nothing), axis=1)
        return values, rows

    def _light(self, number: int, times: Floats) -> tuple[Packets, Rows]:
        values: Packets = []
        columns: list[Floats] = []
        for colour, characteristic in LIGHT_UUIDS.items():
            data, held = _light_packet(number, self._signals.light(times, colour))
            values.append((characteristic, data))
            columns.append(held)
        return values, {"ppg": np.stack(columns, axis=1)}

    def _acceleration(self, number: int, times: Floats) -> tuple[Packets, Rows]:
        data, held = _acceleration_packet(number, self._signals.acceleration_g(times))
        return [(ACC_UUID, data)], {"acc": held}

    def _rotation(self, number: int, times: Floats) -> tuple[Packets, Rows]:
        data, held = _rotation_packet(number, self._signals.rotation_dps(times))
        return [(GYRO_UUID, data)], {"gyro": held}

    async def _tell_battery(self) -> None:
        device_s = self._oscillator.now()
        for number in count():
            measured_s = await self._oscillator.reach(device_s + number * _TELEMETRY_S)
            value, percent = _telemetry_packet(number, self._percent)
            sent = await self._notify(TELEMETRY_UUID, value)
            self._note("bat", [measured_s], [(percent,)], sent=sent)

    def _garbage(self, number: int) -> tuple[str, bytes]:
        """Return a packet that is too short or too long."""
        uuids = [each for each in self._characteristics if each != TELEMETRY_UUID]
        return uuids[number % len(uuids)], self._rng.bytes(17 + 4 * (number % 2))
