"""All LSL outlets of one device, from its first connection to the agent's end."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, replace

from biosensor_common.refusals import Refusals
from biosensor_common.spec import DeviceIdentity, DeviceInfo, FromDevice, SensorSpec
from biosensor_gateway.streaming.counters import Counters
from biosensor_gateway.streaming.outlets import Outlet
from biosensor_gateway.system.clock import LSL_CLOCK, Clock


class DeviceOutlets:
    """All outlets of one device; they outlive its connections.

    They are created at the first successful connection and live until the
    agent ends: a drop-out is a gap, not a vanished stream.
    """

    def __init__(
        self,
        identity: DeviceIdentity,
        spec: SensorSpec,
        clock: Clock = LSL_CLOCK,
        kind: type[Outlet] = Outlet,
    ) -> None:
        self._kind = kind
        self.identity = identity
        self._clock = clock
        self._sensor = spec
        self._outlets: dict[str, Outlet] = {}
        self._expected: DeviceInfo | None = None

    def expect(self, info: DeviceInfo, rates: Mapping[str, float]) -> bool:
        """Create the outlets as they were known before; return whether they can be.

        They are replaced at the connection if the device then says something else. What it
        measures meanwhile waits for receivers who come back; see :meth:`Outlet.await_return`.
        Parameters as in :meth:`open`.
        """
        declared = self._sensor.streams
        told = [rates.get(each.data_name, each.rate) for each in declared]
        if any(isinstance(rate, FromDevice) for rate in told):
            return False
        self.open(info, rates)
        self._expected = info
        for outlet in self._outlets.values():
            outlet.await_return()
        return True

    def open(
        self, info: DeviceInfo, rates: Mapping[str, float]
    ) -> dict[str, tuple[float | FromDevice, float | FromDevice]]:
        """Create the outlets that do not exist yet; rebuild those whose rate changed.

        Parameters
        ----------
        info
            What the device says of itself; the declaration fills the blanks.
        rates
            Nominal rate in Hz by data name, for streams whose rate the device sets.

        Returns
        -------
        dict
            Rate before and after, by data name, of those that were rebuilt.
        """
        changed: dict[str, tuple[float | FromDevice, float | FromDevice]] = {}
        was_wrong = self._expected not in {None, info}
        self._expected = None
        info = replace(
            info,
            manufacturer=info.manufacturer or self._sensor.manufacturer,
            model=info.model or self._sensor.model,
        )
        for declared in self._sensor.streams:
            stream = replace(declared, rate=rates.get(declared.data_name, declared.rate))
            present = self._outlets.get(stream.data_name)
            if present is None or present.stream != stream or was_wrong:
                if present is not None and present.stream != stream:
                    changed[stream.data_name] = (present.stream.rate, stream.rate)
                # The old outlet must be gone before one of the same source_id appears.
                self._outlets.pop(stream.data_name, None)
                del present
                made = self._kind(stream, self.identity, info, self._clock)
                self._outlets[stream.data_name] = made
        return changed

    def close(self) -> None:
        """Destroy all outlets."""
        for outlet in self._outlets.values():
            outlet.close()
        self._outlets.clear()

    def release(self) -> None:
        """Push what waits for a receiver; see :class:`Outlet`."""
        for outlet in self._outlets.values():
            outlet.release()

    def withhold_waiting(self) -> None:
        """Drop what waits for a receiver; see :class:`Outlet`."""
        for outlet in self._outlets.values():
            outlet.withhold_waiting()

    def __getitem__(self, data_name: str) -> Outlet:
        return self._outlets[data_name]

    @property
    def counters(self) -> dict[str, Counters]:
        """Counters by source_id."""
        return {outlet.source_id: outlet.counters for outlet in self._outlets.values()}

    @property
    def refusals(self) -> dict[str, Refusals]:
        """What was not passed on as it came, by source_id."""
        return {outlet.source_id: outlet.refusals for outlet in self._outlets.values()}

    @property
    def rates(self) -> dict[str, float]:
        """Nominal rates in Hz by source_id, 0 of irregular streams."""
        outlets = self._outlets.values()
        return {each.source_id: each.nominal_rate for each in outlets}


def differences(before: DeviceInfo, after: DeviceInfo) -> dict[str, tuple[object, object]]:
    """Return what a device says of itself now and did not before, where it says both."""
    then, now = asdict(before), asdict(after)
    return {
        name: (then[name], now[name])
        for name in then
        if then[name] and now[name] and then[name] != now[name]
    }
