"""Notes in a truth what the samples of a virtual Shimmer3 hold."""

from __future__ import annotations

from math import isnan, nan

from biosensor_gateway.devices.shimmer3_gsr.simulator.streaming import Sample
from biosensor_gateway.simulation.truth import Truth


class Notes:
    """Writes samples into a truth.

    Parameters
    ----------
    truth
        Takes ``gsr``, ``ppg``, and ``quality`` at each change.
    """

    def __init__(self, truth: Truth) -> None:
        self._truth = truth
        self._quality: tuple[float, int] | None = None

    def sent(self, sample: Sample) -> None:
        """Note a sample that left."""
        if sample.gsr_us is not None and sample.gsr_range is not None:
            self._truth.sent("gsr", [sample.measured_s], [[sample.gsr_us]])
            self._note_quality(sample.measured_s, sample.gsr_us, sample.gsr_range)
        if sample.ppg_mv is not None:
            self._truth.sent("ppg", [sample.measured_s], [[sample.ppg_mv]])

    def kept_back(self, sample: Sample) -> None:
        """Note a sample that was measured and never left."""
        if sample.gsr_us is not None:
            self._truth.unsent("gsr", 1)
        if sample.ppg_mv is not None:
            self._truth.unsent("ppg", 1)

    def _note_quality(self, time: float, gsr_us: float, gsr_range: int) -> None:
        quality = (float(not isnan(gsr_us)), gsr_range)
        if quality != self._quality:
            self._quality = quality
            self._truth.sent("quality", [time], [[*quality, nan]])
