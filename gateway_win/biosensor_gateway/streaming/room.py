"""Assigns the streams that fit into this process to devices, in the order of the settings."""

from __future__ import annotations

from biosensor_common import process_limits
from biosensor_common.errors import TransportError

_OWN_STREAMS = 3
"""Counters, events and markers."""


class Room:
    """The devices that have room for their streams.

    Parameters
    ----------
    fits
        How many streams fit; None if there is no limit.
    """

    def __init__(self, fits: int | None) -> None:
        self._fits = fits
        self._taken: dict[str, int] = {}

    @classmethod
    def here(cls, kept: int = 0) -> Room:
        """Return the room of this process, which has not opened a stream yet.

        Room for `kept` more streams is reserved for other files that will be opened.
        """
        fits = process_limits.room(process_limits.OUTLET)
        return cls(None if fits is None else max(0, fits - _OWN_STREAMS - kept))

    def take(self, device: str, streams: int) -> None:
        """Take room for the streams of a device, unless it already has room.

        Raises
        ------
        TransportError
            ``EXHAUSTED``, if they do not fit.
        """
        others = sum(self._taken.values()) - self._taken.get(device, 0)
        if self._fits is not None and others + streams > self._fits:
            raise process_limits.exhausted(f"its {streams} streams are left out")
        self._taken[device] = streams

    def has(self, device: str) -> bool:
        """Whether a device has room."""
        return device in self._taken

    def give_back(self, device: str) -> None:
        """Free the room of a device."""
        self._taken.pop(device, None)

    def share_out(self, devices: dict[str, int]) -> str:
        """Take room for all devices, by name and number of streams, until there is no more.

        Returns
        -------
        str
            How many streams fit and which devices are left out; empty if all have room.
        """
        left_out: list[str] = []
        for device, streams in devices.items():
            try:
                self.take(device, streams)
            except TransportError:
                left_out.append(f"{device} ({streams})")
        if not left_out:
            return ""
        return (
            f"there is room for {self._fits} streams, and {sum(devices.values())} are requested; "
            f"left out are {', '.join(left_out)}: {process_limits.reason()}; "
            f"{process_limits.fix()}"
        )
