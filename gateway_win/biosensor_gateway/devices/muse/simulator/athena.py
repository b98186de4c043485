"""A virtual Muse S Athena: frames of blocks, which wait for each other."""

from __future__ import annotations

from collections import Counter
from collections.abc import Coroutine, Iterable, Mapping
from itertools import count
from types import MappingProxyType
from typing import NamedTuple, Unpack

import numpy as np

from biosensor_gateway.devices.muse.simulator import athena_wire as wire
from biosensor_gateway.devices.muse.simulator.expected import ATHENA
from biosensor_gateway.devices.muse.simulator.headband import Headband
from biosensor_gateway.simulation.radio import Radio
from biosensor_gateway.simulation.specimen import SpecimenOptions
from biosensor_gateway.simulation.virtual_device import Filled
from biosensor_gateway.simulation.wearer import Floats, Wearer
from biosensor_gateway.simulation.world import World

_EPOCH_US = 1_733_145_684_908_000
"""Its clock was never set, and says some day of the past."""
_TICK_S = 0.01
_BLOCK_US = 61
_ELECTRODES = ("TP9", "AF7", "AF8", "TP10", "AUX1", "AUX2", "AUX3", "AUX4")
_PRESETS = {
    "p21": (wire.EEG4, 0),
    "p1034": (wire.EEG4, wire.LIGHT8),
    "p1035": (wire.EEG4, wire.LIGHT4),
    "p1041": (wire.EEG8, wire.LIGHT16),
    "p1043": (wire.EEG8, wire.LIGHT8),
    "p1045": (wire.EEG8, wire.LIGHT4),
}
_INNER = slice(4, 8)

Rows = dict[str, Floats]


class _Source(NamedTuple):
    """What is measured by one tag.

    Attributes
    ----------
    rate_hz
        True one: that of recordings.
    ticks
        It hands on what it has at every so many ticks of the processor.
    """

    tag: int
    rate_hz: float
    ticks: int


class _Waiting(NamedTuple):
    """A block that waits for its frame, and what it holds."""

    block: wire.Block
    times: Floats
    rows: Rows


class SimulatedAthena(Headband):
    """A Muse S Athena; see `Headband`."""

    expected = ATHENA
    filled = MappingProxyType(
        {
            "aux": Filled(None, "it is switched off unless the settings ask"),
            "ppg": Filled(None, "it sends `optics` in its place"),
        }
    )
    kind = "MuseS"
    protocol = 4
    start = "dc001"
    presets = frozenset(_PRESETS)

    def __init__(
        self,
        world: World,
        radio: Radio,
        *,
        address: str = "00:55:DA:B9:FA:20",
        serial: str = "7001-FA20-0001",
        rssi_dbm: int = -57,
        patience_s: float = 120.0,
        **specimen: Unpack[SpecimenOptions],
    ) -> None:
        super().__init__(
            world,
            radio,
            address=address,
            serial=serial,
            rssi_dbm=rssi_dbm,
            patience_s=patience_s,
            **specimen,
        )
        self._offer(wire.DATA_UUIDS)

    @classmethod
    def worn_by(cls, wearer: Wearer, number: int) -> Mapping[str, object]:
        """Give each an address of its own, too."""
        own = {"address": f"00:55:DA:B9:FB:{number:02X}", "serial": f"7001-FB{number:02X}-0002"}
        return {**super().worn_by(wearer, number), **own}

    def _streams(self) -> Iterable[Coroutine[None, None, None]]:
        yield self._send_all()

    async def _send_all(self) -> None:
        eeg, light = _PRESETS[self._preset]
        sources = [
            _Source(eeg, 256.3, 12),
            *([_Source(light, 64.2, 4)] if light else []),
            _Source(wire.MOTION, 51.97, 3),
            _Source(wire.REFERENCE, 32.0, 13),
            _Source(wire.BATTERY, 1.0, 100),
        ]
        begin_s, left_s = self._oscillator.now(), 0.0
        numbers: Counter[int] = Counter()
        waiting: list[_Waiting] = []
        counter = 0
        for tick in count(1):
            now_s = await self._oscillator.reach(begin_s + tick * _TICK_S)
            for each in self._handed_on(sources, tick, begin_s, numbers):
                length = sum(other.block.length for other in waiting)
                if wire.HEADER_BYTES + length + each.block.length > wire.LONGEST_FRAME:
                    left_s = await self._leave(now_s, left_s)
                    await self._send_frame(counter, waiting)
                    counter, waiting = counter + 1, []
                waiting.append(each)

    def _handed_on(
        self, sources: Iterable[_Source], tick: int, begin_s: float, numbers: Counter[int]
    ) -> Iterable[_Waiting]:
        """Return the blocks that are complete, of the sources whose turn it is."""
        stamp_us = _EPOCH_US + round((begin_s + tick * _TICK_S) * 1e6)
        for source in sources:
            samples = wire.SAMPLES[source.tag]
            while not tick % source.ticks:
                first = numbers[source.tag] * samples
                device_s = begin_s + (first + 1 + np.arange(samples)) / source.rate_hz
                if device_s[-1] > begin_s + tick * _TICK_S:
                    break
                times = np.array([self._oscillator.true_time(float(each)) for each in device_s])
                payload, rows = self._measure(source.tag, times)
                block = wire.Block(source.tag, numbers[source.tag], stamp_us, payload)
                numbers[source.tag] += 1
                stamp_us += _BLOCK_US
                yield _Waiting(block, times, rows)

    async def _send_frame(self, counter: int, waiting: list[_Waiting]) -> None:
        uuid = wire.DATA_UUIDS[0]
        if not self._peripheral.subscribed(self._characteristics[uuid]):
            return
        sent = await self._notify(uuid, wire.frame(counter, [each.block for each in waiting]))
        for each in waiting:
            for name, samples in each.rows.items():
                self._note(name, each.times, samples, sent=sent)

    def _measure(self, tag: int, times: Floats) -> tuple[bytes, Rows]:
        """Return the bytes of a block, and its samples by data name."""
        match tag:
            case wire.EEG4 | wire.EEG8:
                names = _ELECTRODES[: wire.WIDTHS[tag]]
                potentials = [self._signals.eeg_uv(times, name) for name in names]
                payload, held = wire.eeg(np.stack(potentials, axis=1))
                return payload, {"eeg": held[:, :4], **({"aux": held[:, 4:]} if tag == wire.EEG8
                    else {})}  # fmt: skip
            case wire.LIGHT4 | wire.LIGHT8 | wire.LIGHT16:
                payload, held = wire.light(self._light(times, wire.WIDTHS[tag]))
                rows = np.full((len(times), 16), np.nan)
                rows[:, _INNER if tag == wire.LIGHT4 else slice(0, held.shape[1])] = held
                return payload, {"optics": rows}
            case wire.MOTION:
                signals = self._signals
                payload, acceleration, rotation = wire.motion(
                    signals.acceleration_g(times), signals.rotation_dps(times)
                )
                return payload, {"acc": acceleration, "gyro": rotation}
            case wire.BATTERY:
                payload, percent = wire.charge(self._percent)
                return payload, {"bat": np.array([[percent]])}
            case _:
                return bytes(24), {}

    def _light(self, times: Floats, width: int) -> Floats:
        """Return light of so many channels: some of the blood, some of the room."""
        colours = ("infrared", "red", "ambient")
        columns = [self._signals.light(times, colours[at % 3]) + 40 * at for at in range(width)]
        return np.stack(columns, axis=1)

    def _garbage(self, number: int) -> tuple[str, bytes]:
        """Return bytes whose length is wrong, or that are no blocks."""
        noise = self._rng.bytes(20)
        wrong = (
            bytes((250,)) + noise if number % 2 else bytes((21, 0, 0)) + noise[:6] + b"\x0f" * 12
        )
        return wire.DATA_UUIDS[0], wrong
