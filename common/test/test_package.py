"""Names, headers and what the package needs; run by ``colcon test``, without other folders."""

from __future__ import annotations

import re
import subprocess
import sys
from xml.etree import ElementTree as ET

import pytest

from biosensor_common import naming
from biosensor_common.errors import SpecError
from biosensor_common.lsl_header import describe, read_header
from biosensor_common.quantities import ChannelFormat, ContentType, Unit
from biosensor_common.spec import DeviceIdentity, DeviceInfo, StreamSpec
from biosensor_common.table import channels, raw

PERSON = DeviceIdentity("acme_band", "A1-7", "p01", "left")
STREAM = raw("acc", ContentType.ACCELEROMETER, channels(Unit.G, "x", "y", "z"), 32.0)
# Whoever sends or receives brings pylsl; rosdep has no key for it.
NEED_PYLSL = {
    "biosensor_common.doctor.lsl_process",
    "biosensor_common.lsl.inlet",
    "biosensor_common.lsl.network",
    "biosensor_common.lsl.outlet",
}

IMPORT_ALL = """
import importlib, pkgutil, sys
import biosensor_common
for name in ("pylsl", "rclpy", "hypothesis"):
    sys.modules[name] = None
for module in pkgutil.walk_packages(biosensor_common.__path__, "biosensor_common."):
    if not module.name.endswith("__main__"):
        try:
            importlib.import_module(module.name)
        except ImportError:
            print(module.name)
"""


def _as_sent(stream: StreamSpec, **changed: str) -> str:
    """Return the description as LSL sends it."""
    info = ET.Element("info")
    fields = {
        "name": naming.lsl_name(PERSON, stream.data_name),
        "type": stream.content_type.value,
        "source_id": naming.source_id(PERSON, stream.data_name),
        "hostname": "lab-pc-1",
        "channel_count": str(len(stream.channels)),
        "nominal_srate": str(stream.rate),
        "channel_format": stream.format.value,
    }
    for name, text in (fields | changed).items():
        ET.SubElement(info, name).text = text
    info.append(describe(stream, PERSON, DeviceInfo()))
    return ET.tostring(info, encoding="unicode")


def test_it_imports_with_what_its_manifest_names() -> None:
    done = subprocess.run(
        [sys.executable, "-c", IMPORT_ALL], check=True, capture_output=True, text=True
    )
    assert set(done.stdout.split()) == NEED_PYLSL


def test_a_header_says_what_was_declared() -> None:
    header = read_header(_as_sent(STREAM))
    assert (header.identity, header.data_name, header.foreign) == (PERSON, "acc", False)
    assert header.labels == ("x", "y", "z")
    assert set(header.units) == {Unit.G}
    assert (header.rate, header.format) == (32.0, ChannelFormat.FLOAT32)
    assert header.message_type is STREAM.message_type


def test_a_header_that_contradicts_its_stream_is_refused() -> None:
    with pytest.raises(SpecError):
        read_header(_as_sent(STREAM, channel_format="string"))


@pytest.mark.parametrize("prefix", ["biosensors", ""])
def test_a_topic_is_a_name_that_ros_takes(prefix: str) -> None:
    odd = DeviceIdentity("acme-band", "A 1", "Ünal", "left wrist")
    for identity in (PERSON, odd):
        name = naming.topic(identity, "acc", prefix, by_unit=True)
        assert re.fullmatch(r"[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*", name), name
    assert naming.topic(PERSON, "acc") == "p01/biosensors/acme_band_left/acc"
