"""Times relative to a defined zero."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

import numpy as np
from numpy.typing import NDArray

from biosensor_common.ros_clock import NS_PER_S
from biosensor_gateway.recording.contents.choice import Chosen
from biosensor_gateway.recording.contents.wall_clock import WallClock
from biosensor_gateway.recording.export.exporter import Clock

_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)


@dataclass(frozen=True, slots=True)
class Timeline:
    """Seconds since the first sample of a selection, on one of the clocks.

    Attributes
    ----------
    zero_s
        The zero on the recorder's LSL clock.
    zero_unix_ns
        Its Unix time; None if unknown.
    """

    zero_s: float
    zero_unix_ns: int | None
    _wall: WallClock | None

    @property
    def begin_s(self) -> float:
        """The zero as LSL time or Unix time, depending on the clock."""
        return self.zero_s if self._wall is None else (self.zero_unix_ns or 0) / NS_PER_S

    def since_zero(self, times: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return seconds since zero.

        Parameters
        ----------
        times : ndarray of float64, shape (n_samples,)
            On the recorder's LSL clock.
        """
        if self._wall is None or self.zero_unix_ns is None:
            return times - self.zero_s
        return (self._wall.to_unix_ns(times) - self.zero_unix_ns) / NS_PER_S

    def described(self) -> dict[str, object]:
        """Return its description for a sidecar."""
        clock = "unix time" if self._wall else "the recorder's LSL clock"
        said: dict[str, object] = {
            "Description": f"first sample of the recording; seconds since it are on {clock}",
            "LslTime": self.zero_s,
        }
        if self.zero_unix_ns is not None:
            date = _EPOCH + timedelta(microseconds=self.zero_unix_ns // 1000)
            said["Date"] = date.isoformat(timespec="microseconds")
        return {"TimeZero": said}


def timeline(chosen: Chosen, clock: Clock) -> Timeline:
    """Return the timeline of a selection."""
    zero_s = max(chosen.begin_s, chosen.contents.begin_s)
    wall = chosen.contents.wall
    unix_ns = None if wall is None else int(wall.to_unix_ns(np.array([zero_s]))[0])
    return Timeline(zero_s, unix_ns, wall if clock is Clock.WALL else None)
