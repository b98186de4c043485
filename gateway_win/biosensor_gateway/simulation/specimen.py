"""Tells a virtual device from others of its kind, whatever kind that is."""

from __future__ import annotations

from typing import TypedDict

from biosensor_gateway.simulation.wearer import Wearer


class SpecimenOptions(TypedDict, total=False):
    """The parameters of `Specimen`, for constructors that pass them on."""

    wearer: Wearer | None
    seed: int
    drift_ppm: float
    jitter_s: float
    kept: int | None


class Specimen:
    """One device of its kind: who wears it, and how far it is from a perfect one.

    Parameters
    ----------
    wearer
        Who wears it; somebody made from ``seed`` by default.
    seed
        Of delays and garbage.
    drift_ppm
        By how much its oscillator runs too fast at first [ppm].
    jitter_s
        What it sends leaves up to so much late [s].
    kept
        Limit of its truth [samples of each stream]; None = all.
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
