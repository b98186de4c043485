"""The interface of those who are told what happens to a device's samples."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Protocol

from numpy.typing import ArrayLike

from biosensor_common.spec import DeviceInfo
from biosensor_gateway.streaming.silence import Silence


class SinkObserver(Protocol):
    """Is told what happens to a device's samples; must neither raise nor wait.

    Of a paused device it hears nothing that was measured. All times are LSL times in
    seconds.
    """

    def connected(self, info: DeviceInfo, changes: Mapping[str, tuple[object, object]]) -> None:
        """Note a connection, and what differs from the one before: before and after, by name."""
        ...

    def sampled(self, data_name: str, samples: ArrayLike, stamps: Sequence[float]) -> None:
        """Note samples that were sent; of text there are stamps only."""
        ...

    def lost(self, data_name: str, count: int, since_s: float) -> None:
        """Note samples that are missing behind the one of `since_s`."""
        ...

    def reanchored(self, cause: str, size_s: float | None, times: int = 1) -> None:
        """Note that the device's clock is mapped anew; None if how far it jumped is unknown.

        Where it jumped several times, the cause is the last one and the size that of all.
        """
        ...

    def fell_silent(self, silence: Silence) -> None:
        """Note streams that are due and do not come, and what is done about it."""
        ...

    def came_back(self, streams: frozenset[str]) -> None:
        """Note that silent streams are heard again."""
        ...

    def paused(self) -> None:
        """Note that nothing is sent from now on."""
        ...

    def resumed(self, send_from_s: float) -> None:
        """Note that what is measured from then on is sent again."""
        ...
