"""A virtual Muse S Athena, which sends blocks in common frames.

Sources: recordings in OpenMuse for the frame, with 16 bits of counter and 48 bits of milliseconds
as in the package openble-muse; OpenMuse (`decode.py`) and BrainFlow (`muse_athena.cpp`) for tags,
lengths, packing and scales of blocks.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Coroutine, Iterable, Mapping, Sequence
from enum import IntEnum
from itertools import count
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from biosensor_gateway.devices.muse.simulator.headband import ATHENA, Headband, uuid
from biosensor_gateway.simulation.virtual_device import Filled
from biosensor_gateway.simulation.wearer import Floats

DATA_UUIDS = (uuid(0x13), uuid(0x14))


class Tag(IntEnum):
    """Tag of a block: a code of its rate, and its kind."""

    EEG4 = 0x11
    EEG8 = 0x12
    LIGHT4 = 0x34
    LIGHT8 = 0x35
    LIGHT16 = 0x36
    MOTION = 0x47
    REFERENCE = 0x53
    BATTERY = 0x98


SAMPLES = {
    Tag.EEG4: 4,
    Tag.EEG8: 2,
    Tag.LIGHT4: 3,
    Tag.LIGHT8: 2,
    Tag.LIGHT16: 1,
    Tag.MOTION: 3,
    Tag.REFERENCE: 6,
    Tag.BATTERY: 1,
}
WIDTHS = {Tag.EEG4: 4, Tag.EEG8: 8, Tag.LIGHT4: 4, Tag.LIGHT8: 8, Tag.LIGHT16: 16}
LONGEST_FRAME = 230
HEADER_BYTES, BLOCK_HEADER_BYTES = 9, 5
_UV, _G, _DPS = 1450 / 16383, 1 / 16384, -245 / 32768


class Block(NamedTuple):
    """A block of one frame."""

    tag: int
    number: int
    stamp_us: int  # Device time at which it was completed.
    payload: bytes

    @property
    def length(self) -> int:
        """Length in bytes, with its header."""
        return BLOCK_HEADER_BYTES + len(self.payload)


def frame(counter: int, blocks: Sequence[Block]) -> bytes:
    """Return a frame of blocks, with their offsets relative to the first one."""
    first_us = blocks[0].stamp_us
    offsets = [first_us % 1000, *(each.stamp_us - first_us for each in blocks[1:])]
    body = b"".join(
        bytes((block.tag, block.number & 0xFF)) + offset.to_bytes(3, "little", signed=True)
        + block.payload
        for block, offset in zip(blocks, offsets, strict=True)
    )  # fmt: skip
    clock = (counter & 0xFFFF).to_bytes(2, "little") + (first_us // 1000).to_bytes(6, "little")
    return bytes((1 + len(clock) + len(body),)) + clock + body


def eeg(microvolts: Floats) -> tuple[bytes, Floats]:
    """Return encoded samples of 4 or 8 electrodes, and the values in them [uV]."""
    counts = np.clip(np.rint(microvolts / _UV) + 8192, 0, (1 << 14) - 1).astype(int)
    return _packed(counts, 14), (counts - 8192) * _UV


def light(values: Floats) -> tuple[bytes, Floats]:
    """Return encoded light samples, and the values in them [counts]."""
    counts = np.clip(np.rint(values), 0, (1 << 20) - 1).astype(int)
    return _packed(counts, 20), counts.astype(float)


def motion(g: Floats, degrees_per_s: Floats) -> tuple[bytes, Floats, Floats]:
    """Return encoded samples of acceleration and rotation, and the values in them."""
    units = np.array([_G] * 3 + [_DPS] * 3)
    counts = np.rint(np.concatenate((g, degrees_per_s), axis=1) / units)
    raw = np.clip(counts, -32768, 32767).astype("<i2")
    held = raw * units
    return raw.tobytes(), held[:, :3], held[:, 3:]


def charge(percent: float) -> tuple[bytes, float]:
    """Return the encoded battery level, and the percentage in it.

    A real headband with a full battery was seen to report 100.5 %.
    """
    raw = 25728 if percent >= 100 else round(percent * 256)
    return raw.to_bytes(2, "little") + bytes(18), min(100.0, raw / 256)


def _packed(counts: np.ndarray[tuple[int, ...], np.dtype[np.int64]], width: int) -> bytes:
    """Pack values bit by bit, each from its lowest bit on."""
    bits = 0
    for place, each in enumerate(counts.reshape(-1)):
        bits |= int(each) << (width * place)
    return bits.to_bytes((width * counts.size + 7) // 8, "little")


# Its clock was never set and shows a date in the past.
_EPOCH_US = 1_733_145_684_908_000
_TICK_S = 0.01
_BLOCK_US = 61
_ELECTRODES = ("TP9", "AF7", "AF8", "TP10", "AUX1", "AUX2", "AUX3", "AUX4")
_PRESETS: Mapping[str, tuple[Tag, Tag | None]] = {
    "p21": (Tag.EEG4, None),
    "p1034": (Tag.EEG4, Tag.LIGHT8),
    "p1035": (Tag.EEG4, Tag.LIGHT4),
    "p1041": (Tag.EEG8, Tag.LIGHT16),
    "p1043": (Tag.EEG8, Tag.LIGHT8),
    "p1045": (Tag.EEG8, Tag.LIGHT4),
}
_INNER = slice(4, 8)

Rows = dict[str, Floats]


class _Source(NamedTuple):
    """The measurement of one tag."""

    tag: Tag
    rate_hz: float  # True rate, as in recordings.
    ticks: int  # Number of processor ticks between blocks.


class _Waiting(NamedTuple):
    """A block that waits for its frame, with its samples."""

    block: Block
    times: Floats
    rows: Rows


class SimulatedAthena(Headband):
    """A Muse S Athena; see `Headband`."""

    expected = ATHENA
    each_own = MappingProxyType(
        {"address": "00:55:DA:B9:FB:{number:02X}", "serial": "7001-FB{number:02X}-0002"}
    )
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
    usual = "00:55:DA:B9:FA:20", "7001-FA20-0001"
    sends_on = DATA_UUIDS

    def _streams(self) -> Iterable[Coroutine[None, None, None]]:
        yield self._send_all()

    async def _send_all(self) -> None:
        eeg, light = _PRESETS[self._preset]
        sources = [
            _Source(eeg, 256.3, 12),
            *([_Source(light, 64.2, 4)] if light else []),
            _Source(Tag.MOTION, 51.97, 3),
            _Source(Tag.REFERENCE, 32.0, 13),
            _Source(Tag.BATTERY, 1.0, 100),
        ]
        begin_s, left_s = self._oscillator.now(), 0.0
        numbers: Counter[int] = Counter()
        waiting: list[_Waiting] = []
        counter = 0
        for tick in count(1):
            now_s = await self._oscillator.reach(begin_s + tick * _TICK_S)
            for each in self._handed_on(sources, tick, begin_s, numbers):
                length = sum(other.block.length for other in waiting)
                if HEADER_BYTES + length + each.block.length > LONGEST_FRAME:
                    left_s = await self._leave(now_s, left_s)
                    await self._send_frame(counter, waiting)
                    counter, waiting = counter + 1, []
                waiting.append(each)

    def _handed_on(
        self, sources: Iterable[_Source], tick: int, begin_s: float, numbers: Counter[int]
    ) -> Iterable[_Waiting]:
        """Return the blocks completed at this tick."""
        stamp_us = _EPOCH_US + round((begin_s + tick * _TICK_S) * 1e6)
        for source in sources:
            samples = SAMPLES[source.tag]
            while not tick % source.ticks:
                first = numbers[source.tag] * samples
                device_s = begin_s + (first + 1 + np.arange(samples)) / source.rate_hz
                if device_s[-1] > begin_s + tick * _TICK_S:
                    break
                times = np.array([self._oscillator.true_time(float(each)) for each in device_s])
                payload, rows = self._measure(source.tag, times)
                block = Block(source.tag, numbers[source.tag], stamp_us, payload)
                numbers[source.tag] += 1
                stamp_us += _BLOCK_US
                yield _Waiting(block, times, rows)

    async def _send_frame(self, counter: int, waiting: list[_Waiting]) -> None:
        uuid = DATA_UUIDS[0]
        if not self._peripheral.subscribed(self._characteristics[uuid]):
            return
        sent = await self._notify(uuid, frame(counter, [each.block for each in waiting]))
        for each in waiting:
            for name, samples in each.rows.items():
                self._note(name, each.times, samples, sent=sent)

    def _measure(self, tag: Tag, times: Floats) -> tuple[bytes, Rows]:
        """Return the payload of a block, and its samples by data name."""
        match tag:
            case Tag.EEG4 | Tag.EEG8:
                names = _ELECTRODES[: WIDTHS[tag]]
                potentials = [self._signals.eeg_uv(times, name) for name in names]
                payload, held = eeg(np.stack(potentials, axis=1))
                return payload, {"eeg": held[:, :4], **({"aux": held[:, 4:]} if tag == Tag.EEG8
                    else {})}  # fmt: skip
            case Tag.LIGHT4 | Tag.LIGHT8 | Tag.LIGHT16:
                payload, held = light(self._light(times, WIDTHS[tag]))
                rows = np.full((len(times), 16), np.nan)
                rows[:, _INNER if tag == Tag.LIGHT4 else slice(0, held.shape[1])] = held
                return payload, {"optics": rows}
            case Tag.MOTION:
                signals = self._signals
                payload, acceleration, rotation = motion(
                    signals.acceleration_g(times), signals.rotation_dps(times)
                )
                return payload, {"acc": acceleration, "gyro": rotation}
            case Tag.BATTERY:
                payload, percent = charge(self._percent)
                return payload, {"bat": np.array([[percent]])}
            case _:
                return bytes(24), {}

    def _light(self, times: Floats, width: int) -> Floats:
        """Return light channels: reflected light and ambient light."""
        colours = ("infrared", "red", "ambient")
        columns = [self._signals.light(times, colours[at % 3]) + 40 * at for at in range(width)]
        return np.stack(columns, axis=1)

    def _garbage(self, number: int) -> tuple[str, bytes]:
        """Return bytes of wrong length or without valid blocks."""
        noise = self._rng.bytes(20)
        wrong = (
            bytes((250,)) + noise if number % 2 else bytes((21, 0, 0)) + noise[:6] + b"\x0f" * 12
        )
        return DATA_UUIDS[0], wrong
