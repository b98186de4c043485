"""One wristband as the server sees it: advertising, connected by radio, lost, off."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from math import inf

import numpy as np

from biosensor_gateway.devices.empatica_e4.simulator.radio_link import RadioLink, Timing
from biosensor_gateway.devices.empatica_e4.simulator.wire import Packet
from biosensor_gateway.devices.empatica_e4.simulator.signals import Signals
from biosensor_gateway.devices.empatica_e4.simulator.wall_clock import Stamps, WallClock
from biosensor_gateway.simulation.crystal import Crystal
from biosensor_gateway.simulation.specimen import Specimen
from biosensor_gateway.simulation.truth import Truth

Deliver = Callable[["Wristband", Packet], None]


class Wristband:
    """A wristband.

    Parameters
    ----------
    device_id
        Six hexadecimal digits.
    specimen
        Who wears it, and what its crystal is like.
    is_allowed
        It is registered to the owner of the server's key.
    truth
        Of what the server sends on.
    deliver
        Gets the packets that arrive, and those that would have during a radio loss.

    Attributes
    ----------
    crystal
        From the wristband's first moment on.
    stamps
        Of the present or last radio link.
    is_left_alone
        A client had its link ended: the server does not connect it by itself.
    """

    def __init__(
        self,
        device_id: str,
        specimen: Specimen,
        timing: Timing,
        *,
        is_allowed: bool,
        truth: Truth,
        deliver: Deliver,
    ) -> None:
        self.device_id = device_id
        self.signals = Signals(specimen.wearer)
        self.truth = truth
        self.is_allowed = is_allowed
        self.is_left_alone = False
        self._timing = timing
        self._drift_ppm = specimen.drift_ppm
        self._rng = np.random.default_rng((specimen.seed, 0xE4))
        self._deliver = deliver
        self._is_on = True
        self._is_lost = False
        self._is_in_reach = True
        self._link: RadioLink | None = None
        self._patience_s = inf
        self._gives_up: asyncio.TimerHandle | None = None
        self._lost_share = 0.0
        self._loses_until_s = 0.0

    def begin(self, clock: WallClock) -> None:
        """Let time begin: for the wearer, the crystal and on the server's PC."""
        self._begin_s = clock.lsl()
        self.crystal = Crystal(clock.lsl, self._drift_ppm, self._begin_s)
        self._clock = clock
        self.stamps = Stamps(clock)

    @property
    def is_connected(self) -> bool:
        """Tell whether its radio link stands."""
        return self._link is not None and not self._is_lost

    @property
    def is_lost(self) -> bool:
        """Tell whether it was connected and its radio is out of reach, or was."""
        return self._is_lost

    @property
    def is_advertising(self) -> bool:
        """Tell whether a radio link can be made."""
        return self._is_on and self._is_in_reach and not self.is_connected

    def connect(self, patience_s: float = inf) -> None:
        """Make a radio link; it streams from now on, by a new reference.

        Parameters
        ----------
        patience_s
            How long it stays discoverable after the link was lost.
        """
        self._end_link()
        self._patience_s = patience_s
        self._is_lost = self.is_left_alone = False
        self.stamps = Stamps(self._clock)
        self._link = RadioLink(
            self.signals, self.crystal, self._begin_s, self._timing, self._rng, self._arrived
        )

    def disconnect(self) -> None:
        """End the radio link in order; the wristband advertises again."""
        self._end_link()
        self._is_lost = False

    def lose(self) -> None:
        """Be out of the radio's reach; what is measured meanwhile never arrives."""
        self._is_in_reach = False
        if self.is_connected:
            self._is_lost = True
            if self._patience_s < inf:
                loop = asyncio.get_running_loop()
                self._gives_up = loop.call_later(self._patience_s, self._give_up)

    def come_back(self) -> None:
        """Be in reach again."""
        self._is_in_reach = True

    def turn_off(self) -> None:
        """Be turned off by the button."""
        self._give_up()

    def turn_on(self) -> None:
        """Be turned on by the button."""
        self._is_on = True

    def press_button(self) -> None:
        """Send a tag, if a radio link stands."""
        if self._link is not None:
            self._link.tag()

    def lose_packets(self, share: float, seconds: float) -> None:
        """Lose a share of the packets, from 0 to 1, on the radio; their stamps show no gap."""
        self._lost_share = share
        self._loses_until_s = self._clock.lsl() + seconds

    def loses(self, packet: Packet) -> bool:
        """Tell whether a packet of a regular stream gets lost on the radio."""
        if packet.samples[0].stream.rate_hz is None or packet.arrives_s > self._loses_until_s:
            return False
        return self._rng.random() < self._lost_share

    def _arrived(self, packet: Packet) -> None:
        self._deliver(self, packet)

    def _give_up(self) -> None:
        self.disconnect()
        self._is_on = False

    def _end_link(self) -> None:
        if self._gives_up is not None:
            self._gives_up.cancel()
            self._gives_up = None
        if self._link is not None:
            self._link.end()
            self._link = None
