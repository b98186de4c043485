"""Hearts and senders that are out of the ordinary, with known beats; see `hearts_measured`."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from tests.features import signals
from tests.features.signals import Array, Case

SECONDS = 60.0
ECG_HZ = (100.0, 130.0, 250.0)
PPG_HZ = (25.0, 64.0, 100.0)
Draw = np.random.Generator
Change = Callable[[Array, float, Draw], Array]
"""What a fault makes of a signal of this rate."""


def _seed(draw: Draw) -> int:
    return int(draw.integers(1 << 30))


def _hearts(
    draw: Draw, kinds: tuple[str, ...] = ("ECG", "PPG"), rates: tuple[float, ...] = ()
) -> Iterator[Case]:
    """Yield one heart of any usual rate for each rate of sampling."""
    for kind in kinds:
        for rate in rates or (ECG_HZ if kind == "ECG" else PPG_HZ):
            bpm = float(draw.uniform(45, 120))
            seed = _seed(draw)
            beats = signals.regular(bpm, SECONDS, 0.03, seed)
            make = signals.ecg_of if kind == "ECG" else signals.pulse_of
            signal = make(beats, rate, SECONDS, seed=seed)
            yield Case(f"{bpm:.0f}/min, {kind} of {rate:g} Hz", kind, rate, signal, beats)


def _changed(
    draw: Draw, changes: dict[str, Change], times: int = 1, kinds: tuple[str, ...] = ("ECG", "PPG")
) -> Iterator[Case]:
    for name, change in changes.items():
        for _ in range(times):
            for case in _hearts(draw, kinds):
                signal = change(case.signal, case.rate, draw)
                yield case._replace(name=f"{name}, {case.name}", signal=signal)


def small_beats(draw: Draw) -> Iterator[Case]:
    """Every second or third beat of an ECG is small, and early or not."""
    for every in (2, 3):
        for share in (0.08, 0.12, 0.16, 0.2, 0.3, 0.45):
            for coupling in (0.5, 0.6, 0.75, 1.0):
                rate, bpm = float(draw.choice(ECG_HZ)), float(draw.uniform(50, 95))
                seed = _seed(draw)
                beats = signals.regular(bpm, SECONDS, 0.02, seed)
                small = np.arange(len(beats)) % every == every - 1
                early = beats - small * (1 - coupling) * 60 / bpm
                large = signals.ecg_of(early[~small], rate, SECONDS, seed)
                signal = large + share * signals.ecg_of(early[small], rate, SECONDS, seed + 1)
                name = f"each {every}. beat {share}, after {coupling}, {bpm:.0f}/min, {rate:g} Hz"
                yield Case(name, "ECG", rate, signal, early)


def small_pulses(draw: Draw) -> Iterator[Case]:
    """Every second or third pulse is small, and early or not."""
    for every in (2, 3):
        for share in (0.15, 0.25, 0.4, 0.6):
            for coupling in (0.6, 0.75, 1.0):
                rate, bpm = float(draw.choice(PPG_HZ)), float(draw.uniform(50, 95))
                seed = _seed(draw)
                beats = signals.regular(bpm, SECONDS, 0.02, seed)
                small = np.arange(len(beats)) % every == every - 1
                early = beats - small * (1 - coupling) * 60 / bpm
                heights = np.where(small, share, 1.0)
                signal = signals.pulse_of(early, rate, SECONDS, seed=seed, heights=heights)
                name = f"each {every}. beat {share}, after {coupling}, {bpm:.0f}/min, {rate:g} Hz"
                yield Case(name, "PPG", rate, signal, early)


def swinging_levels(draw: Draw) -> Iterator[Case]:
    """The level of a pulse swings as fast as a slow heart, evenly or not."""
    for height in (0.3, 0.5, 0.8, 1.2, 2.0):
        for uneven in (0.0, 0.02, 0.05):
            for rate in PPG_HZ:
                seed = _seed(draw)
                bpm, hertz = float(draw.uniform(50, 110)), float(draw.uniform(0.55, 0.85))
                beats = signals.regular(bpm, SECONDS, 0.03, seed)
                signal = signals.pulse_of(beats, rate, SECONDS, seed=seed)
                signal += signals.swing_of(SECONDS, rate, hertz, height, uneven)
                name = f"{height} at {60 * hertz:.0f}/min by {uneven}, {bpm:.0f}/min, {rate:g} Hz"
                yield Case(name, "PPG", rate, signal, beats)
    # At half of the pulse's rate, or near it.
    for height in (0.5, 1.0, 2.0):
        for part in (0.48, 0.5, 0.52):
            for rate in PPG_HZ:
                seed, bpm = _seed(draw), float(draw.uniform(72, 96))
                beats = signals.regular(bpm, SECONDS, 0.02, seed)
                signal = signals.pulse_of(beats, rate, SECONDS, seed=seed)
                t = np.arange(len(signal)) / rate
                signal += height * np.sin(2 * np.pi * part * bpm / 60 * t + draw.uniform(0, 6))
                name = f"{height} at {part} of the pulse, {bpm:.0f}/min, {rate:g} Hz"
                yield Case(name, "PPG", rate, signal, beats)


def superposed(draw: Draw) -> Iterator[Case]:
    """The pulse of somebody else, or an ECG of somebody else, lies over the first."""
    for kind, rates in (("ECG", ECG_HZ), ("PPG", PPG_HZ)):
        make = signals.ecg_of if kind == "ECG" else signals.pulse_of
        for share in (0.3, 0.5, 0.7, 0.85):
            for apart in (0.6, 0.8, 1.15, 1.4, 1.8):
                rate, bpm, seed = (
                    float(draw.choice(rates)),
                    float(draw.uniform(55, 95)),
                    _seed(draw),
                )
                beats = signals.regular(bpm, SECONDS, 0.03, seed)
                others = signals.regular(bpm * apart, SECONDS, 0.03, seed + 1)
                signal = make(beats, rate, SECONDS, seed=seed)
                signal += share * make(others, rate, SECONDS, seed=seed + 2)
                name = f"{share} of {apart} times, {bpm:.0f}/min, {kind} of {rate:g} Hz"
                yield Case(name, kind, rate, signal, beats)


def _held(most_s: float, share: float) -> Change:
    def change(signal: Array, rate: float, draw: Draw) -> Array:
        signal, place = signal.copy(), 0
        while place < len(signal):
            length = max(2, round(draw.uniform(0.3, 1) * most_s * rate))
            signal[place : place + length] = signal[place]
            place += length + round(draw.exponential(length * (1 - share) / share))
        return signal

    return change


def held_values(draw: Draw, most_s: Sequence[float] = (0.5, 1.0, 2.0, 4.0)) -> Iterator[Case]:
    """A converter that is stuck repeats its value for a while, again and again."""
    changes = {
        f"up to {each} s, {share}": _held(each, share)
        for each in most_s
        for share in (0.1, 0.3, 0.6)
    }
    return _changed(draw, changes)


def values_held_briefly(draw: Draw) -> Iterator[Case]:
    """The same, but never for longer than recorders that compress hold an ECG, or hardly."""
    return held_values(draw, (0.2,))


def _twice(block_s: float, often: float, back: int = 1) -> Change:
    def change(signal: Array, rate: float, draw: Draw) -> Array:
        signal, length = signal.copy(), max(2, round(block_s * rate))
        for begin in range(back * length, len(signal) - length, length):
            if draw.random() < often:
                before = begin - back * length
                signal[begin : begin + length] = signal[before : before + length]
        return signal

    return change


def sent_twice(draw: Draw) -> Iterator[Case]:
    """Blocks come in the place of the ones that follow them, or of later ones."""
    changes = {
        f"{block_s} s, {often}, {back} later": _twice(block_s, often, back)
        for block_s in (0.2, 0.4, 0.8, 1.5, 3.0)
        for often in (0.1, 0.4)
        for back in (1, 2)
    }
    return _changed(draw, changes)


def large_t_waves(draw: Draw) -> Iterator[Case]:
    """T waves are higher than R waves, at any rate of the heart."""
    for height in (0.6, 1.0, 1.3, 1.6, 2.0):
        for bpm in (30, 40, 50, 65, 90, 120):
            rate, seed = float(draw.choice(ECG_HZ)), _seed(draw)
            beats = signals.regular(bpm, SECONDS, 0.03, seed)
            signal = signals.ecg_of(beats, rate, SECONDS, seed)
            t = np.arange(len(signal)) / rate
            for beat, length_s in zip(beats, np.append(np.diff(beats), 0.8), strict=True):
                late_s = 0.28 * np.sqrt(min(length_s, 1.2) / 0.85)
                signal += (height - 0.3) * np.exp(-0.5 * ((t - beat - late_s) / 0.04) ** 2)
            yield Case(f"T wave {height}, {bpm}/min, {rate:g} Hz", "ECG", rate, signal, beats)


def growing(draw: Draw) -> Iterator[Case]:
    """The amplitude grows or falls a lot, at once or in seconds."""
    for kind, rates in (("ECG", ECG_HZ), ("PPG", PPG_HZ)):
        make = signals.ecg_of if kind == "ECG" else signals.pulse_of
        for factor in (100.0, 10.0, 0.1, 0.01):
            for within_s in (0.1, 2.0, 5.0, 10.0):
                for bpm in (28, 36, 45, 75, 120):
                    rate, seed = float(draw.choice(rates)), _seed(draw)
                    beats = signals.regular(bpm, SECONDS, 0.02, seed)
                    signal = make(beats, rate, SECONDS, seed=seed)
                    t = np.arange(len(signal)) / rate
                    signal *= factor ** np.clip((t - 25.3) / within_s, 0, 1)
                    name = f"{factor} within {within_s} s, {bpm}/min, {kind} of {rate:g} Hz"
                    yield Case(name, kind, rate, signal, beats)


def faults(draw: Draw) -> Iterator[Case]:
    """What converters, mains and links do to signals."""

    def rail(signal: Array, rate: float, draw: Draw) -> Array:
        del rate
        return np.clip(signal, *np.quantile(signal, sorted(draw.uniform([0, 0.85], [0.1, 1]))))

    def steps(signal: Array, rate: float, draw: Draw) -> Array:
        at = draw.random(len(signal)) < 0.2 / rate
        return signal + np.cumsum(at * draw.uniform(-3, 3, len(signal)))

    def bursts(signal: Array, rate: float, draw: Draw) -> Array:
        signal = signal.copy()
        for begin in np.flatnonzero(draw.random(len(signal)) < 0.1 / rate):
            end = min(len(signal), begin + round(draw.uniform(0.2, 2) * rate))
            signal[begin:end] += draw.uniform(0.3, 3) * draw.standard_normal(end - begin)
        return signal

    def hum(hertz: float) -> Change:
        def change(signal: Array, rate: float, draw: Draw) -> Array:
            t = np.arange(len(signal)) / rate
            size = draw.uniform(0.05, 2)
            return signal + size * np.sin(2 * np.pi * hertz * (1 + draw.normal(0, 2e-3)) * t)

        return change

    def coarse(count: int) -> Change:
        def change(signal: Array, rate: float, draw: Draw) -> Array:
            del rate, draw
            step = np.ptp(signal) / count
            return np.round(signal / step)

        return change

    def breathing(signal: Array, rate: float, draw: Draw) -> Array:
        t = np.arange(len(signal)) / rate
        return signal * (1 + 0.6 * np.sin(2 * np.pi * draw.uniform(0.1, 0.4) * t))

    def inverted(signal: Array, rate: float, draw: Draw) -> Array:
        del rate, draw
        return -signal

    def spikes(signal: Array, rate: float, draw: Draw) -> Array:
        at = draw.random(len(signal)) < 0.5 / rate
        return signal + at * draw.choice([-1, 1]) * draw.uniform(1, 20)

    changes: dict[str, Change] = {
        "rail": rail,
        "steps": steps,
        "bursts": bursts,
        "hum of 50": hum(50),
        "hum of 60": hum(60),
        "255 steps": coarse(255),
        "20 steps": coarse(20),
        "8 steps": coarse(8),
        "breathing": breathing,
        "inverted": inverted,
        "spikes": spikes,
    }
    return _changed(draw, changes, times=4)


def left_out(draw: Draw) -> Iterator[Case]:
    """Samples are left out, and the stamps of those which follow are early."""
    for longest_s in (0.05, 0.3, 1.0):
        for case in _hearts(draw):
            kept = np.ones(len(case.signal), np.bool_)
            for begin in np.flatnonzero(draw.random(len(kept)) < 0.2 / case.rate):
                kept[
                    begin : begin + max(1, round(draw.uniform(0.1, 1) * longest_s * case.rate))
                ] = 0
            # Nobody can know more than what is there.
            places = np.round(case.beats * case.rate).astype(int)
            places = places[(places < len(kept)) & kept[np.minimum(places, len(kept) - 1)]]
            beats = np.cumsum(kept)[places] / case.rate
            name = f"up to {longest_s} s, {case.name}"
            yield case._replace(name=name, signal=case.signal[kept], beats=beats)


def any_rate(draw: Draw) -> Iterator[Case]:
    """Any rate of sampling, of hearts from 30 to 220."""
    for kind, rates in (
        ("ECG", (80.0, 100.0, 128.0, 200.0, 512.0, 1000.0)),
        ("PPG", (20.0, 25.0, 50.0, 100.0, 250.0, 512.0, 1000.0)),
    ):
        make = signals.ecg_of if kind == "ECG" else signals.pulse_of
        for rate in rates:
            for bpm in (30, 60, 180, 200, 210, 220):
                seed = _seed(draw)
                beats = signals.regular(bpm, SECONDS, 0.02, seed)
                signal = make(beats, rate, SECONDS, seed=seed)
                yield Case(f"{bpm}/min, {kind} of {rate:g} Hz", kind, rate, signal, beats)


def ectopic(draw: Draw) -> Iterator[Case]:
    """Wide early beats, with a pause behind them, each second to fifth one or by chance."""
    for every in (0, 2, 3, 4, 5):
        for bpm in (50, 65, 80, 100):
            for kind, rates in (("ECG", ECG_HZ), ("PPG", PPG_HZ)):
                rate, seed = float(draw.choice(rates)), _seed(draw)
                beats = signals.regular(bpm, SECONDS, 0.02, seed)
                number = np.arange(len(beats))
                early = draw.random(len(beats)) < 0.15 if not every else number % every == every - 1
                early[1:] &= ~early[:-1]
                coupling = draw.uniform(0.5, 0.75)
                beats = beats - early * (1 - coupling) * 60 / bpm
                if kind == "PPG":
                    heights = np.where(early, draw.uniform(0.1, 0.9), 1.0)
                    signal = signals.pulse_of(beats, rate, SECONDS, seed=seed, heights=heights)
                else:
                    signal = signals.ecg_of(beats[~early], rate, SECONDS, seed)
                    t = np.arange(len(signal)) / rate
                    size, width = (
                        draw.choice([-1, 1]) * draw.uniform(0.5, 2),
                        draw.uniform(0.03, 0.05),
                    )
                    for beat in beats[early]:
                        signal += size * np.exp(-0.5 * ((t - beat) / width) ** 2)
                        signal -= 0.4 * size * np.exp(-0.5 * ((t - beat - 0.3) / 0.06) ** 2)
                name = f"each {every}. after {coupling:.2f}, {bpm}/min, {kind} of {rate:g} Hz"
                yield Case(name, kind, rate, signal, beats)


def flutter(draw: Draw) -> Iterator[Case]:
    """Atria flutter, and each second to fourth flutter is followed by a beat."""
    for parts in (2, 3, 4):
        for per_minute in (240, 270, 300, 330):
            for size in (0.1, 0.25, 0.4):
                rate, seed = float(draw.choice(ECG_HZ)), _seed(draw)
                beats = signals.regular(per_minute / parts, SECONDS, 0.005, seed)
                signal = signals.ecg_of(beats, rate, SECONDS, seed)
                t = np.arange(len(signal)) / rate
                phase = np.interp(t, beats, parts * np.arange(len(beats)))
                signal -= size * (1 - (phase + draw.uniform()) % 1)
                name = f"{parts}:1 of {per_minute}, {size}, {rate:g} Hz"
                yield Case(name, "ECG", rate, signal, beats)


def cadence(draw: Draw) -> Iterator[Case]:
    """Steps near the rate of the heart, or near a multiple or part of it."""
    for times in (0.5, 0.9, 1.1, 1.3, 1.5, 2.0):
        for height in (0.5, 1.0, 2.0):
            for rate in PPG_HZ:
                seed, bpm = _seed(draw), float(draw.uniform(65, 130))
                beats = signals.regular(bpm, SECONDS, 0.03, seed)
                signal = signals.pulse_of(beats, rate, SECONDS, seed=seed)
                signal += signals.swing_of(SECONDS, rate, times * bpm / 60, height, 0.02)
                name = f"{height} at {times} of {bpm:.0f}/min, {rate:g} Hz"
                yield Case(name, "PPG", rate, signal, beats)


def paced(draw: Draw) -> Iterator[Case]:
    """Spikes of a pacemaker before each beat."""
    for size in (0.5, 2.0, 5.0):
        for bpm in (50, 60, 70, 90):
            for rate in (130.0, 250.0, 500.0):
                seed = _seed(draw)
                beats = signals.regular(bpm, SECONDS, 0.002, seed)
                signal = signals.ecg_of(beats, rate, SECONDS, seed)
                for beat in beats - draw.uniform(0.04, 0.18):
                    place = round(beat * rate)
                    signal[place : place + max(1, round(0.002 * rate))] += size
                name = f"spikes of {size}, {bpm}/min, {rate:g} Hz"
                yield Case(name, "ECG", rate, signal, beats)


def wandering(draw: Draw) -> Iterator[Case]:
    """Noise, wandering levels, and an irregular heart together."""
    for kind in ("ECG", "PPG"):
        for noise in (0.02, 0.1, 0.3):
            for wander in (0.0, 0.5, 2.0):
                for spread in (0.05, 0.2):
                    rate = float(draw.choice(ECG_HZ if kind == "ECG" else PPG_HZ))
                    bpm, seed = float(draw.uniform(50, 120)), _seed(draw)
                    beats = signals.fibrillation(bpm, SECONDS, spread, seed)
                    make = signals.ecg_of if kind == "ECG" else signals.pulse_of
                    signal = make(beats, rate, SECONDS, seed=seed)
                    signal += noise * draw.standard_normal(len(signal))
                    t = np.arange(len(signal)) / rate
                    for hertz in draw.uniform(0.05, 0.5, 3):
                        signal += wander / 3 * np.sin(2 * np.pi * hertz * t + draw.uniform(0, 6))
                    name = f"noise {noise}, wander {wander}, {bpm:.0f}/min by {spread}"
                    yield Case(f"{name}, {kind} of {rate:g} Hz", kind, rate, signal, beats)


KINDS: dict[str, Callable[[Draw], Iterator[Case]]] = {
    each.__name__.replace("_", " "): each
    for each in (
        small_beats,
        small_pulses,
        swinging_levels,
        superposed,
        held_values,
        values_held_briefly,
        sent_twice,
        large_t_waves,
        growing,
        faults,
        left_out,
        any_rate,
        ectopic,
        flutter,
        cadence,
        paced,
        wandering,
    )
}
