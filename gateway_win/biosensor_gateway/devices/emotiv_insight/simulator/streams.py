"""Data streams: measures samples on time, sends them to subscribers, and records the truth."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import ceil, floor, nan, pi
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from biosensor_gateway.devices.emotiv_insight import SPEC
from biosensor_gateway.devices.emotiv_insight.simulator.account import Session
from biosensor_gateway.devices.emotiv_insight.simulator.headset import Columns, Model
from biosensor_gateway.devices.emotiv_insight.simulator.listener import Client
from biosensor_gateway.simulation.truth import Truth
from biosensor_gateway.simulation.wearer import Floats, Wearer
from biosensor_gateway.simulation.world import Oscillator

Sample = dict[str, Any]
"""Values by column; None for missing values."""
Integers = NDArray[np.int64]
Signal = Callable[[Integers, Floats], list[Sample]]
"""Returns samples for numbers since power-on and true times of the wearer [s]."""

_OFFSET_UV = 4200.0
_BANDS_UV2_HZ = {"theta": 5.0, "alpha": 6.0, "betaL": 2.4, "betaH": 1.1, "gamma": 0.4}
_METRICS = ("eng", "exc", "lex", "str", "rel", "int", "foc", "attention")
_MAGNETIC_FIELD_UT = (22.0, 5.0, -42.0)
_GYROSCOPE_ZERO = 8192
_GYROSCOPE_SCALE = 2000.0


class Signals:
    """The signals of one headset on one head.

    Parameters
    ----------
    model, wearer, seed
        Headset model and wearer; the seed determines contact quality and offsets.
    """

    def __init__(self, model: Model, wearer: Wearer, seed: int) -> None:
        self.is_worn = True
        self.battery_percent = 80
        self._model = model
        self._wearer = wearer
        self._seed = seed
        rng = np.random.default_rng((seed, 0xDC))
        self._offsets = _OFFSET_UV + rng.uniform(-80, 80, len(model.electrodes))

    def sources(self) -> dict[str, tuple[float, Signal]]:
        """Return rate [Hz] and signal of each stream of this headset."""
        sources: dict[str, tuple[float, Signal]] = {
            "eeg": (self._model.eeg_rate, self.eeg),
            "pow": (8, self.band_power),
            "met": (2, self.metrics),
            "dev": (2, self.device),
            "eq": (2, self.eeg_quality),
        }
        if self._model.motion_rate:
            sources["mot"] = (self._model.motion_rate, self.motion)
        return sources

    def eeg(self, numbers: Integers, t: Floats) -> list[Sample]:
        """Measure the EEG with its DC offset [uV], in whole ADC steps."""
        wearer, step = self._wearer, self._model.resolution_uv
        potentials = np.stack(
            [
                wearer.eeg_uv(t, name) if self.is_worn else wearer.noise(t, 40.0, f"open {name}")
                for name in self._model.electrodes
            ],
            axis=1,
        )
        potentials = np.round(np.rint((self._offsets + potentials) / step) * step, 3)
        return [
            {
                "COUNTER": number % self._model.eeg_rate,
                "INTERPOLATED": 0,
                **dict(zip(self._model.electrodes, row, strict=True)),
                "RAW_CQ": 1024.0 if self.is_worn else 0.0,
                "MARKER_HARDWARE": 0,
                "MARKERS": [],
            }
            for number, row in zip(numbers.tolist(), potentials.tolist(), strict=True)
        ]

    def motion(self, numbers: Integers, t: Floats) -> list[Sample]:
        """Measure a nodding and turning head: orientation, acceleration [g], field [uT].

        Q0 is the scalar part of the rotation from body to world coordinates, in which the
        acceleration at rest is along -Z.
        """
        yaw, yaw_rate = _swing(t, 0.5, 11.0)
        pitch, pitch_rate = _swing(t, 0.2, 7.0)
        sway = [self._wearer.noise(t, 0.004, f"head {axis}") for axis in "xyz"]
        gravity = (np.zeros(t.shape), np.zeros(t.shape), -np.ones(t.shape))
        field = tuple(np.full(t.shape, strength) for strength in _MAGNETIC_FIELD_UT)
        acceleration = [a + s for a, s in zip(_to_body(gravity, yaw, pitch), sway, strict=True)]
        attitude = (
            _angular_rates(yaw_rate, pitch_rate)
            if self._model.has_gyroscope
            else _quaternion(yaw, pitch)
        )
        names = ("ACCX", "ACCY", "ACCZ", "MAGX", "MAGY", "MAGZ")
        fields = zip(names, (*acceleration, *_to_body(field, yaw, pitch)), strict=True)
        columns: dict[str, Floats] = {**attitude, **dict(fields)}
        samples = _rows({name: np.round(values, 6) for name, values in columns.items()})
        for number, sample in zip(numbers.tolist(), samples, strict=True):
            sample["COUNTER_MEMS"] = number % self._model.motion_rate
            sample["INTERPOLATED_MEMS"] = 0
        return samples

    def band_power(self, numbers: Integers, t: Floats) -> list[Sample]:
        """Measure the power in each band [uV^2/Hz]; 0 without contact."""
        del numbers
        columns: dict[str, Floats] = {}
        for k, name in enumerate(self._model.electrodes):
            for band, level in _BANDS_UV2_HZ.items():
                swing = 1 + 0.3 * np.sin(2 * pi * t / (5.0 + k) + level)
                columns[f"{name}/{band}"] = np.round(level * swing * self.is_worn, 3)
        return _rows(columns)

    def metrics(self, numbers: Integers, t: Floats) -> list[Sample]:
        """Return performance metrics, 0 to 1; the interest is sometimes missing."""
        samples: list[Sample] = []
        for number, time_s in zip(numbers.tolist(), t.tolist(), strict=True):
            sample: Sample = {}
            for k, name in enumerate(_METRICS):
                is_active = self.is_worn and not (name == "int" and number % 8 == 7)
                level = 0.5 + 0.4 * np.sin(2 * pi * time_s / (9.0 + k) + k)
                sample[f"{name}.isActive"] = is_active
                sample[name] = round(float(level), 6) if is_active else None
            samples.append(sample)
        return samples

    def device(self, numbers: Integers, t: Floats) -> list[Sample]:
        """Return grades of the battery (0-4), the radio (0-1) and each contact (0-4)."""
        del t
        return [
            {
                "Battery": ceil(self.battery_percent / 25),
                "Signal": 1.0,
                **contact,
                "OVERALL": _overall(contact),
                "BatteryPercent": self.battery_percent,
            }
            for contact in map(self._contact, numbers.tolist())
        ]

    def eeg_quality(self, numbers: Integers, t: Floats) -> list[Sample]:
        """Return grades of each channel's signal (0-4) and the overall quality [percent]."""
        del t
        return [
            {
                "batteryPercent": self.battery_percent,
                "overall": _overall(quality),
                "sampleRateQuality": 1.0,
                **quality,
            }
            for quality in map(self._contact, numbers.tolist())
        ]

    def _contact(self, number: int) -> dict[str, int]:
        names = self._model.electrodes
        if not self.is_worn:
            return dict.fromkeys(names, 0)
        grades = np.random.default_rng((self._seed, number)).integers(2, 5, len(names))
        return dict(zip(names, grades.tolist(), strict=True))


def _overall(grades: dict[str, int]) -> int:
    return round(25 * sum(grades.values()) / len(grades))


def _swing(t: Floats, amplitude: float, period_s: float) -> tuple[Floats, Floats]:
    """Return an angle [rad] and its rate [rad/s]."""
    omega = 2 * pi / period_s
    return amplitude * np.sin(omega * t), amplitude * omega * np.cos(omega * t)


def _quaternion(yaw: Floats, pitch: Floats) -> dict[str, Floats]:
    """Combine yaw about the vertical and pitch about y, from body to world coordinates."""
    cy, sy, cp, sp = np.cos(yaw / 2), np.sin(yaw / 2), np.cos(pitch / 2), np.sin(pitch / 2)
    return {"Q0": cy * cp, "Q1": -sy * sp, "Q2": cy * sp, "Q3": sy * cp}


def _angular_rates(yaw_rate: Floats, pitch_rate: Floats) -> dict[str, Floats]:
    """Return counts around a zero of 8192; the vendor documents no scale."""
    rates = {"GYROX": np.zeros(yaw_rate.shape), "GYROY": pitch_rate, "GYROZ": yaw_rate}
    return {n: np.rint(_GYROSCOPE_ZERO + _GYROSCOPE_SCALE * rate) for n, rate in rates.items()}


def _to_body(vector: tuple[Floats, ...], yaw: Floats, pitch: Floats) -> tuple[Floats, ...]:
    """Convert a vector from world to body coordinates."""
    x, y, z = vector
    ahead = np.cos(yaw) * x + np.sin(yaw) * y
    aside = -np.sin(yaw) * x + np.cos(yaw) * y
    return (np.cos(pitch) * ahead - np.sin(pitch) * z, aside,
            np.sin(pitch) * ahead + np.cos(pitch) * z)  # fmt: skip


def _rows(columns: dict[str, Floats]) -> list[Sample]:
    names = tuple(columns)
    table = np.stack(tuple(columns.values()), axis=1).tolist()
    return [dict(zip(names, row, strict=True)) for row in table]


_AHEAD_S = 0.25
_TRUE_OF = {"eeg": ("eeg", "eeg_status"), "mot": ("mot", "gyro")}
_LABELS = {stream.data_name: stream.labels for stream in SPEC.streams}
_DECLARED_AS = {
    "eng": "engagement",
    "exc": "excitement",
    "lex": "long_term_excitement",
    "str": "stress",
    "rel": "relaxation",
    "int": "interest",
    "foc": "focus",
    "GYROX": "X",
    "GYROY": "Y",
    "GYROZ": "Z",
}


@dataclass(frozen=True, slots=True)
class Stage:
    """The environment of a stream."""

    oscillator: Oscillator  # Device clock: sample `k` is at device time `k / rate`.
    begin_s: float  # LSL time at which the wearer's time is 0.
    jitter_s: float  # Maximum transport delay.
    rng: np.random.Generator
    truth: Truth
    delivers: Callable[[], bool]  # Whether the headset's data reach Cortex.
    is_unreadable: Callable[[], bool]  # Whether samples of every stream have an unannounced column.
    subscribed: Callable[[str], list[tuple[Session, Client]]]
    stamp: Callable[[float], float]  # Converts a device time [s] to Cortex's clock [Unix s].
    changes: Callable[[], int]  # Counter of changes that invalidate precomputed samples.


class Stream:
    """One data stream of the headset."""

    def __init__(
        self,
        name: str,
        rate: float,
        signal: Signal,
        columns: Columns,
        stage: Stage,
    ) -> None:
        self._name = name
        self._rate = rate
        self._signal = signal
        self._columns = columns
        self._stage = stage
        self._is_wanted = asyncio.Event()
        self._true_columns = _declared(columns)
        self._true_names = tuple(
            data_name
            for data_name in _TRUE_OF.get(name, (name,))
            if set(_LABELS.get(data_name, ())) & self._true_columns.keys()
        )

    def wake(self) -> None:
        """Check for subscribers."""
        self._is_wanted.set()

    async def run(self) -> None:
        """Deliver samples until cancelled, but only while there are subscribers."""
        while True:
            await self._is_wanted.wait()
            self._is_wanted.clear()
            number = floor(self._stage.oscillator.now() * self._rate) + 1
            while self._stage.subscribed(self._name):
                number = await self._run_block(number)

    async def _run_block(self, number: int) -> int:
        """Measure a block in advance, and deliver each sample on time; return the next number."""
        stage = self._stage
        changes = stage.changes()
        numbers = number + np.arange(max(1, round(_AHEAD_S * self._rate)))
        true_times = [stage.oscillator.true_time(k / self._rate) for k in numbers.tolist()]
        samples = self._signal(numbers, np.array(true_times) - stage.begin_s)
        leaves_s = 0.0
        for k, true_s, sample in zip(numbers.tolist(), true_times, samples, strict=True):
            leaves_s = max(leaves_s, true_s + stage.rng.uniform(0, stage.jitter_s))
            await asyncio.sleep(leaves_s - stage.oscillator.clock())
            if stage.changes() != changes:
                return k
            self._deliver(k, true_s, sample)
        return number + len(numbers)

    def _deliver(self, number: int, true_s: float, sample: Sample) -> None:
        clients = [
            (session, client)
            for session, client in self._stage.subscribed(self._name)
            if client.is_open
        ]
        if not clients or not self._stage.delivers():
            return
        takers = [taker for taker in clients if taker[1].has_room]
        if not takers or self._stage.is_unreadable():
            for data_name in self._true_names:
                self._stage.truth.unsent(data_name, 1)
            for session, client in takers:
                client.send(self._write(number, sample, session.session_id, ["?"]))
            return
        # Recorded before sending, so that everything a client has read is in the truth.
        self._note(true_s, sample)
        for session, client in takers:
            client.send(self._write(number, sample, session.session_id))

    def _write(
        self, number: int, sample: Sample, session_id: str, further: Sequence[str] = ()
    ) -> str:
        values = [*_arranged(sample, self._columns), *further]
        time_s = round(self._stage.stamp(number / self._rate), 4)
        return json.dumps({self._name: values, "sid": session_id, "time": time_s})

    def _note(self, true_s: float, sample: Sample) -> None:
        for data_name in self._true_names:
            columns = (self._true_columns.get(label) for label in _LABELS[data_name])
            row = [nan if column is None else _number(sample[column]) for column in columns]
            self._stage.truth.sent(data_name, (true_s,), (row,))


def _declared(columns: Columns) -> dict[str, str]:
    """Return the sent columns by their label in the declaration."""
    flat: list[str] = []
    for column in columns:
        flat += column if isinstance(column, list) else [column]
    return {_DECLARED_AS.get(column, column): column for column in flat}


def _arranged(sample: Sample, columns: Columns) -> list[Any]:
    return [
        [sample[inner] for inner in column] if isinstance(column, list) else sample[column]
        for column in columns
    ]


def _number(value: object) -> float:
    return nan if value is None else float(cast("float", value))
