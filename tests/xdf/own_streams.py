"""Headers of our own streams, by their declarations."""

from __future__ import annotations

from biosensor_common.lsl_header import describe
from biosensor_common.naming import lsl_name, source_id
from biosensor_common.spec import DeviceIdentity, DeviceInfo
from biosensor_gateway.devices.registry import declaration
from tests.xdf import xdf_file as x


def own_header(stream_id: int, identity: DeviceIdentity, data_name: str) -> bytes:
    """Return the header chunk of a stream with a fixed rate, or none."""
    spec = declaration(identity.sensor).stream(data_name)
    assert isinstance(spec.rate, int | float)
    return x.stream_header(
        stream_id,
        lsl_name(identity, data_name),
        kind=spec.content_type.value,
        channels=len(spec.channels),
        rate=float(spec.rate),
        fmt=spec.format.value,
        source_id=source_id(identity, data_name),
        desc=describe(spec, identity, DeviceInfo()),
    )
