"""The interface between drivers and the agent: takes a device's samples, and finds restarts."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Protocol

from biosensor_common.device_clock import ClockState
from biosensor_common.spec import DeviceIdentity

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from biosensor_gateway.system.clock import Clock

AGREE_S = 1.0
"""Tolerance between the device's and the host's length of a pause, if the device stayed on."""
DRIFT = 1e-3
"""Far more than the error of any oscillator."""


class Sink(Protocol):
    """Takes the data of one device, over all its connections.

    A driver reports packets with :meth:`observe`, then passes their samples with times on the
    device's own clock. The agent implements it as
    :class:`~biosensor_gateway.streaming.sink.DeviceSink`.
    A protocol, because help and settings import drivers, and must work without numpy and liblsl.
    """

    dropped_bytes: int  # Bytes without a valid message; drivers add to it.
    # Returns how long packets may recently have waited for this computer, in seconds.
    own_delay: Callable[[], float]
    # Labels of channels that this device does not send, by data name: their values are NaN, and
    # nothing of them is missing.
    lacking: dict[str, Sequence[str]]

    @property
    def identity(self) -> DeviceIdentity:
        """Identity of the device, for the log."""
        ...

    @property
    def clock(self) -> Clock:
        """The LSL clock."""
        ...

    @property
    def clock_state(self) -> ClockState:
        """Offset and drift of the device's clock, as far as they are known."""
        ...

    @property
    def is_waiting(self) -> bool:
        """Whether a stream was restarted and no data has arrived since."""
        ...

    def observe(self, device_s: float, arrival_s: float, kind: str = "") -> None:
        """Add the device time of a packet's last sample and its LSL time of arrival.

        Give `kind` if packets of that kind keep their order; see :meth:`DeviceClock.observe`.
        """
        ...

    def restart_clock(self) -> None:
        """Restart the mapping of device times, because the device restarted its clock.

        Samples with device times can only be emitted after the next observation.
        """
        ...

    def emit(self, data_name: str, samples: ArrayLike, device_times: Sequence[float]) -> None:
        """Push samples.

        Parameters
        ----------
        samples : array_like, shape (n_samples, n_channels) or (n_samples,)
            In the units of the declaration.
        device_times : sequence of float, length n_samples
            Device clock of each sample in seconds.
        """
        ...

    def emit_at(self, data_name: str, samples: ArrayLike, lsl_times: Sequence[float]) -> None:
        """Push samples with LSL times, for data without device timestamps.

        Parameters
        ----------
        samples : array_like, shape (n_samples, n_channels) or (n_samples,)
            In the units of the declaration.
        lsl_times : sequence of float, length n_samples
            Best estimate of the LSL time of each sample, in seconds.
        """
        ...

    def emit_on_arrival(self, data_name: str, value: float, arrival_s: float) -> None:
        """Push one value of a one-channel stream, sent at once and without a timestamp.

        If it arrived with stored packets, it gets the time of the packet before it. Samples that
        are late all the same are reported.
        """
        ...

    def note_arrival(self, data_name: str, arrival_s: float, count: int = 1) -> None:
        """Note samples with times based on an arrival, which are reported if it turns out late."""
        ...

    def emit_value(self, data_name: str, value: float | None, device_s: float) -> None:
        """Push one value of a one-channel stream; None is "no value", which sends nothing."""
        ...

    def emit_text(self, data_name: str, text: str, device_s: float) -> None:
        """Push one string sample with a time on the device's clock."""
        ...

    def lost(self, data_name: str, count: int) -> None:
        """Count samples that the device measured but that never arrived."""
        ...

    def left_out(self, count: int, why: str) -> None:
        """Count samples that arrived but are not emitted, such as copies; *why* is a clause."""
        ...

    def heard(self, *data_names: str) -> None:
        """Note valid data from the device, about these streams or in general.

        Emitted samples are noted automatically; call this only for data without samples.
        """
        ...

    def remark(self, about: str, text: str = "") -> None:
        """Show a problem with the data to the user; an empty text clears it.

        It stays in the device's status until cleared or until the next connection.
        """
        ...

    def excuse(self, *data_names: str) -> None:
        """Stop monitoring these streams until data arrive again, for a known reason."""
        ...


class RestartCheck:
    """Compares the first timestamp of each connection with the device's known clock.

    Data may have been stored since the start of a measurement and arrive late together, so
    lateness alone does not indicate a restart. If the clock continued, the first packet's time
    lies between the start and its arrival.
    """

    def __init__(self, sink: Sink, agree_s: float = AGREE_S) -> None:
        self._sink = sink
        self._agree_s = agree_s
        self._started_s = -math.inf
        self._is_new = True

    def reconnected(self) -> None:
        """Expect the first packet of a connection, before its measurements are started."""
        self._is_new = True
        self._started_s = self._sink.clock()

    def counts_again(self, stamp_s: float, arrival_s: float) -> bool:
        """Whether the device's clock restarted; False for later packets of a connection."""
        is_new, self._is_new = self._is_new, False
        if not is_new:
            return False
        state = self._sink.clock_state
        if math.isnan(state.offset_s):
            return False
        measured_s = stamp_s + state.offset_s
        # Data stored in the device were lost with the previous connection, so nothing is older.
        limit_s = self._agree_s + DRIFT * max(0.0, arrival_s - state.newest_s)
        earliest_s = max(state.newest_s, min(self._started_s, arrival_s) - limit_s)
        return not earliest_s <= measured_s <= arrival_s + limit_s
