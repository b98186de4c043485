"""Agent and node of 0.1.0 and of today understand each other's headers.

``headers_0_1_0`` holds what the agent of 0.1.0 wrote for each of its streams, and
``reader_0_1_0`` the modules by which its node read them: both as they were.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest

from biosensor_common.errors import SpecError, SpecReason
from biosensor_common.lsl_header import describe, read_header
from biosensor_common.quantities import ACCELERATION, MAGNETIC_FIELD, ORIENTATION, ChannelRole
from biosensor_common.spec import DeviceIdentity, DeviceInfo
from biosensor_common.stream_header import MAX_FIELD_CHARACTERS, StreamHeader
from tests.rigs.headers import declared_streams, lsl_xml

HERE = Path(__file__).parent
INFO = DeviceInfo("maker", "model", "serial", "1.2")
FROZEN = {
    path.stem: path.read_text(encoding="utf-8")
    for path in sorted((HERE / "headers_0_1_0").glob("*.xml"))
}
READ_BY_0_1_0 = """
import json, sys
from dataclasses import astuple
from biosensor_common import lsl_header
assert "reader_0_1_0" in lsl_header.__file__
headers = json.load(sys.stdin)
json.dump({name: astuple(lsl_header.read_header(xml)) for name, xml in headers.items()}, sys.stdout)
"""


def present() -> dict[str, str]:
    """What the agent writes today, for the devices of the frozen headers."""
    headers: dict[str, str] = {}
    for name, stream in declared_streams():
        identity = DeviceIdentity(name, "U1", participant="p01", label="left")
        headers[f"{name}.{stream.data_name}"] = lsl_xml(
            stream, identity, describe(stream, identity, INFO)
        )
    return headers


def read_by_0_1_0(headers: dict[str, str]) -> dict[str, list[object]]:
    """All fields of each header, by a process that knows the old modules alone."""
    outcome = subprocess.run(
        [sys.executable, "-c", READ_BY_0_1_0],
        input=json.dumps(headers),
        env={**os.environ, "PYTHONPATH": str(HERE / "reader_0_1_0")},
        capture_output=True,
        text=True,
        check=True,
    )
    return json.loads(outcome.stdout)


def test_a_header_of_0_1_0_was_kept_of_every_stream_of_its_sensors() -> None:
    assert len(FROZEN) == 53
    assert FROZEN.keys() <= present().keys()


@pytest.mark.parametrize("name", FROZEN)
def test_what_a_header_of_0_1_0_leaves_unsaid_is_what_is_said_today(name: str) -> None:
    assert "<role>" not in FROZEN[name]
    assert "<is_state>" not in FROZEN[name]
    header = read_header(FROZEN[name])
    assert not header.foreign
    assert header == read_header(present()[name])


@pytest.mark.nightly
def test_a_reader_of_0_1_0_reads_the_present_headers_as_its_own() -> None:
    today = {name: xml for name, xml in present().items() if name in FROZEN}
    assert "<role>" in "".join(today.values())
    read = read_by_0_1_0(today)
    assert read.keys() == FROZEN.keys()
    assert read == read_by_0_1_0(FROZEN)


def altered(name: str, *changes: tuple[str, str], of: dict[str, str] = FROZEN) -> StreamHeader:
    xml = of[name]
    for old, new in changes:
        assert old in xml
        xml = xml.replace(old, new)
    return read_header(xml)


QUALITY, BATTERY = "zephyr.quality", "zephyr.bat"
DEVICE, MOTION = "emotiv_insight.dev", "emotiv_insight.mot"


@pytest.mark.parametrize(
    ("name", "change"),
    [
        (QUALITY, ("<label>worn<", "<label>loose<")),
        (QUALITY, ("<type>Quality<", "<type>Activity<")),
        (QUALITY, ("<unit>boolean<", "<unit>index<")),
        (BATTERY, ("<unit>percent<", "<unit>millivolts<")),
        (BATTERY, ("<type>Battery<", "<type>Quality<")),
        (BATTERY, ("<type>Battery<", "<type>Of Another Package<")),
        (DEVICE, ("<unit>percent<", "<unit>index<")),
        (DEVICE, ("<type>Status<", "<type>Quality<")),
        (DEVICE, (">BatteryPercent<", ">Percent<")),
        (MOTION, ("<type>MoCap<", "<type>Accelerometer<")),
        (MOTION, ("<channels>", "<channels><channel/>")),
    ],
)
def test_what_only_looks_alike_has_no_role(name: str, change: tuple[str, str]) -> None:
    assert any(altered(name).roles)
    roles = altered(name, change).roles
    assert roles == (None,) * len(roles)


def test_a_component_in_another_unit_has_no_role() -> None:
    motion = altered(MOTION, ("<unit>g<", "<unit>m/s^2<"))
    assert set(motion.roles) == {None, *ORIENTATION, *MAGNETIC_FIELD}
    assert set(altered(MOTION).roles) == {*ORIENTATION, *ACCELERATION, *MAGNETIC_FIELD}


def test_a_stream_with_a_rate_was_no_state_in_0_1_0() -> None:
    assert not altered("emotiv_insight.eeg_status").is_state
    assert altered(DEVICE).is_state
    assert not altered(BATTERY, (">0.000000000000000</nominal", ">1.0</nominal")).is_state


def test_what_is_said_counts_and_nothing_is_inferred_beside_it() -> None:
    silent = (
        ("<role>state_of_charge</role>", ""),
        ("<is_state>true</is_state>", "<is_state>false</is_state>"),
    )
    header = altered(BATTERY, *silent, of=present())
    assert (header.roles, header.is_state) == ((None,), False)
    # Each of the two is optional by itself.
    header = altered(BATTERY, silent[0], of=present())
    assert (header.roles, header.is_state) == ((None,), True)
    header = altered(BATTERY, ("<is_state>true</is_state>", ""), of=present())
    assert (header.roles, header.is_state) == ((ChannelRole.STATE_OF_CHARGE,), False)


@pytest.mark.parametrize(
    "role",
    ["blood_pressure", "STATE_OF_CHARGE", " state_of_charge", "contact", "r" * 5000, "&#233;", ""],
)
def test_a_role_of_a_later_version_or_in_another_unit_is_ignored(role: str) -> None:
    header = altered(BATTERY, (">state_of_charge<", f">{role}<"), of=present())
    assert (header.foreign, header.roles, header.is_state) == (False, (None,), True)
    assert header.labels == ("level",)


@pytest.mark.parametrize(
    ("name", "old", "new", "reason"),
    [
        (BATTERY, ">true<", "><", SpecReason.INVALID),
        (BATTERY, ">true<", ">True<", SpecReason.INVALID),
        (BATTERY, ">true<", ">1<", SpecReason.INVALID),
        (BATTERY, ">true<", f">{'t' * (MAX_FIELD_CHARACTERS + 1)}<", SpecReason.TOO_LARGE),
        (BATTERY, "<is_state>", "<is_state>true</is_state><is_state>", SpecReason.MALFORMED),
        ("zephyr.ecg", "<is_state>false", "<is_state>true", SpecReason.CONTRADICTORY),
    ],
)
def test_a_false_claim_to_be_a_state_is_refused_in_one_sentence(
    name: str, old: str, new: str, reason: SpecReason
) -> None:
    with pytest.raises(SpecError) as refused:
        altered(name, (old, new), of=present())
    assert refused.value.reason is reason
    assert "state" in str(refused.value)
    assert "\n" not in str(refused.value)


def test_roles_of_another_programs_stream_are_not_believed() -> None:
    root = ET.fromstring(present()[BATTERY])
    desc, block = root.find("desc"), root.find("desc/biosensor")
    assert desc is not None
    assert block is not None
    desc.remove(block)
    header = read_header(ET.tostring(root, encoding="unicode"))
    assert (header.foreign, header.roles, header.is_state) == (True, (None,), False)
