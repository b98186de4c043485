"""The SDK mode: more rates and ranges, and neither heart rate nor intervals."""

from __future__ import annotations

from biosensor_gateway.devices.polar_h10.driver.control import ControlPoint
from biosensor_gateway.devices.polar_h10.driver.protocol.control_point import (
    Measurement,
    Status,
    start,
    stop,
)
from biosensor_gateway.system.device_log import DeviceLog

LEAVE = stop(Measurement.SDK_MODE)
_ENTER = start(Measurement.SDK_MODE, {})


class SdkMode:
    """Brings a device into the mode that is wanted, before its measurements start.

    A device is taken out of the mode, too: a host before us may have left it there, and then
    no heart rate would come.

    Parameters
    ----------
    is_wanted
    log
    """

    def __init__(self, *, is_wanted: bool, log: DeviceLog) -> None:
        self._is_wanted = is_wanted
        self._log = log

    async def prepare(self, control: ControlPoint, offered: frozenset[int]) -> None:
        """Switch the mode.

        Parameters
        ----------
        control
        offered
            Numbers of what the device can measure, or switch like a measurement.

        Raises
        ------
        TransportError
            ``LOST`` or ``SILENT``.
        AttError
            The device refuses to take a command.
        ProtocolError
            ``NO_REPLY``.
        """
        if Measurement.SDK_MODE not in offered:
            if self._is_wanted:
                self._log.warn_once("it has no SDK mode; set sdk_mode = false, or update it")
            return
        command = _ENTER if self._is_wanted else LEAVE
        reply = await control.request(command)
        if reply.status == Status.INVALID_STATE:
            # The mode cannot change while something runs, which a host before us left on.
            for measurement in sorted(offered & _MEASUREMENTS):
                await control.request(stop(Measurement(measurement)))
            reply = await control.request(command)
        is_there = reply.status in (Status.SUCCESS, Status.ALREADY_IN_STATE)
        if self._is_wanted and not is_there:
            self._log.warn_once("it refuses the SDK mode", cause=reply.status_text)


_MEASUREMENTS = frozenset(Measurement) - {Measurement.SDK_MODE}
