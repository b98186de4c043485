"""Takes a device's samples from its driver; all that a driver sees of the agent."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Protocol

from biosensor_common.device_clock import ClockState
from biosensor_common.spec import DeviceIdentity

if TYPE_CHECKING:
    # Neither numpy nor LSL is needed to know what there are for sensors.
    from numpy.typing import ArrayLike

    from biosensor_gateway.system.clock import Clock


class Sink(Protocol):
    """Takes what one device sends; there is one for each device, over all its connections.

    A driver reports packets with :meth:`observe`, then hands over their samples with times on
    the device's own clock. The agent's is :class:`~biosensor_gateway.streaming.sink.DeviceSink`.

    Attributes
    ----------
    dropped_bytes
        Bytes that made no valid message; drivers add to it.
    own_delay
        Tells for how many seconds a packet may have had to wait for this computer lately.
    """

    dropped_bytes: int
    own_delay: Callable[[], float]

    @property
    def identity(self) -> DeviceIdentity:
        """Which device it is, for the log."""
        ...

    @property
    def clock(self) -> Clock:
        """Tells LSL time."""
        ...

    @property
    def clock_state(self) -> ClockState:
        """Offset and drift of the device's clock, as far as they are known."""
        ...

    @property
    def is_waiting(self) -> bool:
        """Whether a stream was enabled again, and has not been heard since."""
        ...

    def observe(self, device_s: float, arrival_s: float, kind: str = "") -> None:
        """Take in the device time of a packet's last sample and its LSL time of arrival.

        If packets of a kind keep their order, its name helps; see :meth:`DeviceClock.observe`.
        """
        ...

    def restart_clock(self) -> None:
        """Map device times again from the next observation on: the device counts again.

        Nothing can be emitted with device times before that observation.
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
        """Push samples that the device does not stamp, with times on the LSL clock already.

        Parameters
        ----------
        samples : array_like, shape (n_samples, n_channels) or (n_samples,)
            In the units of the declaration.
        lsl_times : sequence of float, length n_samples
            LSL clock at each sample, as near as can be told, in seconds.
        """
        ...

    def emit_on_arrival(self, data_name: str, value: float, arrival_s: float) -> None:
        """Push one value of a one-channel stream that the device does not stamp and sends at once.

        Where it came with packets that had waited, it is as old as the one before it; what is
        stamped late all the same is reported.
        """
        ...

    def note_arrival(self, data_name: str, arrival_s: float, count: int = 1) -> None:
        """Have samples reported that were placed by an arrival, should it turn out late."""
        ...

    def emit_value(self, data_name: str, value: float | None, device_s: float) -> None:
        """Push one value of a one-channel stream; None is "no value", which sends nothing."""
        ...

    def emit_text(self, data_name: str, text: str, device_s: float) -> None:
        """Push one string sample measured at a time of the device's clock."""
        ...

    def lost(self, data_name: str, count: int) -> None:
        """Count samples that the device measured and that never arrived."""
        ...

    def left_out(self, count: int, why: str) -> None:
        """Count samples that arrived and are not emitted, such as copies; *why* is a clause."""
        ...

    def heard(self, *data_names: str) -> None:
        """Note that the device said something valid: about these streams, or in general.

        Samples are noted by themselves, so only what comes without a value has to be told.
        """
        ...

    def remark(self, about: str, text: str = "") -> None:
        """Have a person see what is wrong with what comes, though it goes on; empty when over.

        It stands in the device's status until then, or until the next connection.
        """
        ...

    def excuse(self, *data_names: str) -> None:
        """Expect nothing of these streams until they are heard again: there is a reason."""
        ...
