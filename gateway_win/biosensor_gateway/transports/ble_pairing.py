"""Decides when a Bluetooth LE device is paired, and when it is forgotten again.

Nothing here asks the system for anything, so that what holds for Windows alone can be tried
anywhere. What it goes by was told by users of Windows 11 and was not seen here yet: straps with
new firmware answer "insufficient authentication" to a host that is not paired, or drop the
connection while their services are looked up [1]_ [2]_; a pairing that outlives the connection
makes the next one fail [1]_; and services that Windows remembers are those of a connection that
is gone [3]_.

References
----------
.. [1] https://github.com/hbldh/bleak/issues/1943
.. [2] https://github.com/polarofficial/polar-ble-sdk/issues/774
.. [3] https://github.com/hbldh/bleak/issues/2017
"""

from __future__ import annotations

import sys
from typing import Annotated, Literal

from pydantic import BeforeValidator

from biosensor_common.errors import GatewayError, TransportError, TransportReason
from biosensor_gateway.transports.ble_errors import UNLIKELY_ERROR, AttError

Wish = Literal["auto", "yes", "no"]
PLATFORM = sys.platform
EARLY_DROP_S = 5.0
"""Who drops a host that is not paired does so at once."""


def _of_switch(value: object) -> object:
    """Read a switch as a wish: on pairs first, off pairs where the device demands it."""
    if isinstance(value, bool):
        return "yes" if value else "auto"
    return value


PairSetting = Annotated[Wish, BeforeValidator(_of_switch)]
"""Type of the setting ``pair`` of a device."""
PAIR_DESCRIPTION = (
    "auto pairs when the device demands it, or drops a connection at once on Windows; yes pairs "
    "before each connection; no never pairs, for a device that the system's settings have paired."
)


class Pairing:
    """What is known of one device's wish to be paired; shared by all its connections.

    Parameters
    ----------
    wish
        The setting.
    platform
        As ``sys.platform`` names it; this one by default.

    Attributes
    ----------
    comes_first
        Whether to pair before connecting.
    """

    def __init__(self, wish: Wish = "auto", platform: str = "") -> None:
        self._wish = wish
        self._is_windows = (platform or PLATFORM) == "win32"
        self._is_ours = False
        self.comes_first = wish == "yes"

    @property
    def uses_known_services(self) -> bool:
        """Whether the system may tell the services that it remembers, and not ask the device."""
        return not self._is_windows

    @property
    def ends_with_connection(self) -> bool:
        """Whether to unpair before disconnecting: Windows would fail to use the pairing again."""
        return self._is_windows and self._is_ours

    def helps(self, error: GatewayError, *, is_unanswered: bool) -> bool:
        """Whether to connect once more, and pair, for what went wrong is as without a pairing.

        BlueZ may keep the device's answer to itself: then the first requests fail with another
        error, or nothing comes of them.

        Parameters
        ----------
        is_unanswered
            Something was asked of the device that it may refuse to who is not paired, and
            nothing of that kind has come through yet.
        """
        if self._wish == "no":
            return False
        if isinstance(error, AttError):
            return error.wants_pairing or (error.code == UNLIKELY_ERROR and is_unanswered)
        return (
            isinstance(error, TransportError)
            and error.reason is TransportReason.SILENT
            and is_unanswered
        )

    def note_demand(self) -> None:
        """Note that the device demands it: Windows, which forgets it each time, pairs first."""
        self.comes_first = self.comes_first or self._is_windows

    def note_drop(self, after_s: float) -> None:
        """Note that a device which was in range ended a connection, or did not let it begin.

        Parameters
        ----------
        after_s
            Seconds from the connection; 0 if it did not begin.
        """
        if self._is_windows and self._wish == "auto" and not self._is_ours:
            # Paired in vain is as bad as unpaired in vain: in turns, one of them works.
            self.comes_first = after_s < EARLY_DROP_S and not self.comes_first

    def note_paired(self) -> None:
        """Note that the system has paired the device for us."""
        self._is_ours = True

    def note_unpaired(self) -> None:
        """Note that it has forgotten the device."""
        self._is_ours = False
