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
        Empty if only `name` is known, which may then be a name or a source_id.
    must_have_samples
        Whether samples are expected too; an event stream may be empty.
    """

    name: str
    source_id: str = ""
    must_have_samples: bool = False

    def is_met_by(self, header: RecordedHeader) -> bool:
        """Whether a recorded stream matches."""
        if self.source_id:
            return header.source_id == self.source_id
        return self.name in (header.name, header.source_id)


def by_name(names: Iterable[str]) -> tuple[ExpectedStream, ...]:
    """Return expected streams, given by name or source_id; each must have samples."""
    return tuple(ExpectedStream(name, must_have_samples=True) for name in names)


def by_devices(devices: Iterable[DeviceSettings]) -> tuple[ExpectedStream, ...]:
    """Return every stream of every enabled device in the settings.

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
