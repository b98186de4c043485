"""The streams that a recording is expected to have."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from biosensor_common.naming import lsl_name, source_id
from biosensor_gateway.devices.registry import declared
from biosensor_gateway.recording.xdf.header import RecordedHeader
from biosensor_gateway.settings.models import DeviceSettings


@dataclass(frozen=True, slots=True)
class ExpectedStream:
    """A stream that should be there.

    Attributes
    ----------
    source_id
        Empty if `name` is all that is known of it; it may be either then.
    must_have_samples
        Whether to expect samples too; a sensor's event may never have happened.
    """

    name: str
    source_id: str = ""
    must_have_samples: bool = False

    def is_met_by(self, header: RecordedHeader) -> bool:
        """Whether a recorded stream is the expected one."""
        if self.source_id:
            return header.source_id == self.source_id
        return self.name in (header.name, header.source_id)


def by_name(names: Iterable[str]) -> tuple[ExpectedStream, ...]:
    """Expect streams by name or source_id, with samples."""
    return tuple(ExpectedStream(name, must_have_samples=True) for name in names)


def by_devices(devices: Iterable[DeviceSettings]) -> tuple[ExpectedStream, ...]:
    """Expect every stream of every enabled device of the settings.

    Raises
    ------
    SpecError
        If a sensor's declaration cannot be loaded.
    """
    expected: list[ExpectedStream] = []
    for device in devices:
        if device.enabled:
            identity = device.identity
            expected += [
                ExpectedStream(
                    lsl_name(identity, stream.data_name), source_id(identity, stream.data_name)
                )
                for stream in declared(device).streams
            ]
    return tuple(expected)
