"""The meaning of BioHarness frames, and other devices at the port."""

from __future__ import annotations

import asyncio
import datetime as dt
import json
import struct
from collections.abc import Callable
from dataclasses import fields as fields_of
from functools import cache
from importlib.resources import files
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from biosensor_common.errors import ProtocolError, ProtocolReason
from biosensor_gateway.devices.driver import Found
from biosensor_gateway.devices.zephyr import driver as module
from biosensor_gateway.devices.zephyr.driver import (
    DRIVER,
    ZephyrSettings,
    messages,
    protocol,
    recognise,
)
from biosensor_gateway.devices.zephyr.driver.protocol import (
    LIFESIGN,
    Frame,
    FrameParser,
    MessageId,
    Request,
    ZephyrProtocol,
    enable,
    request,
)
from biosensor_gateway.transports.nearby import Advertisement, SerialPort
from tests.rigs.driver_run import NotedSink

# The meaning of BioHarness frames, against captured and generated vectors.

_150S, _WITH_GAP = "zephyr_bh3_2012-09-26_150s.dat", "zephyr_bh3_2012-04-06_with_gap.dat"
_HEADER = bytes.fromhex("01ea07011f18572605")
_EVENTS = {0x0080: "battery_low", 0x10C0: "fall", 0x1140: "dash", 0x1234: "unknown"}
_REQUESTS = {
    "cmd_disable_general": enable(Request.GENERAL, on=False),
    "cmd_enable_breathing": enable(Request.BREATHING, on=True),
    "cmd_enable_ecg": enable(Request.ECG, on=True),
    "cmd_enable_accel": enable(Request.ACCELERATION, on=True),
    "cmd_enable_accel100mg": request(0xBC, b"\x01"),
    "cmd_summary_every_1s": enable(Request.SUMMARY, on=True),
    "cmd_summary_off": enable(Request.SUMMARY, on=False),
    "cmd_lifesign": LIFESIGN,
}


class _Vector(NamedTuple):
    data: bytes
    expected: dict[str, Any]


def _load() -> dict[str, _Vector]:
    path = Path(__file__).parent / "vectors" / "zephyr_bioharness.json"
    document: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    vectors: dict[str, _Vector] = {}
    for entry in document["vectors"]:
        # A note is a remark for the reader, the only key that states nothing about the bytes.
        expected = {key: value for key, value in entry["expected"].items() if key != "note"}
        vectors[entry["name"]] = _Vector(bytes.fromhex(entry["hex"]), expected)
    return vectors


_VECTORS = _load()
_SINGLE_FRAMES = [name for name, vector in _VECTORS.items() if "msg_id" in vector.expected]


@cache
def _recorded(name: str) -> list[messages.Message]:
    package = files("biosensor_gateway.devices.zephyr")
    return ZephyrProtocol().feed(package.joinpath("simulator", "recordings", name).read_bytes())


def _only(data: bytes) -> messages.Message:
    (message,) = ZephyrProtocol().feed(data)
    return message


def _summary(version: int, changes: dict[int, bytes], fill: int = 0) -> messages.Summary:
    payload = bytearray((*_HEADER, version, *[fill] * 61))
    for offset, data in changes.items():
        payload[offset : offset + len(data)] = data
    message = _only(request(MessageId.SUMMARY, bytes(payload)))
    assert isinstance(message, messages.Summary)
    return message


def _stamp(header: messages.Header) -> dict[str, object]:
    assert header.time is not None
    assert header.device_s is not None
    time = header.time.isoformat(timespec="milliseconds")
    ms_of_day = round(1000 * header.device_s) % 86_400_000
    return {"seq": header.sequence, "time": time, "ms_of_day": ms_of_day}


def _event(event: messages.Event) -> dict[str, object]:
    said: dict[str, object] = {}
    if event.name.endswith("_change"):
        said["before"], said["after"] = event.data
    if event.name == "jump":
        said["flight_ms"], peak = struct.unpack("<Hh", event.data)
        said["peak_g"] = peak / 100
    parts = {"type": event.code >> 12, "source": event.code >> 6 & 0x3F, "id": event.code & 0x3F}
    return {**said, **parts, "data": event.data.hex()}


def _said(message: messages.Message) -> dict[str, Any]:
    """Flatten what a message says to the names that the vectors use."""
    said: dict[str, Any] = {item.name: getattr(message, item.name) for item in fields_of(message)}
    if "header" in said:
        said |= _stamp(said["header"])
    said |= said.get("numbers", {}) | said.get("extra", {})
    said["aux_adc"] = [said.get(f"aux_adc_{number}") for number in (1, 2, 3)]
    said["samples"] = [*said.get("samples", ())]
    said["period_ms"] = 1000 * said.get("period_s", protocol.RR_PERIOD_S)
    if isinstance(message, messages.Acceleration):
        said["xyz"] = [[*sample] for sample in message.samples]
        said["period_ms"] = 1000 * protocol.ACCELERATION_PERIOD_S
    if isinstance(message, messages.Summary):
        said |= message.status.flags
        said["status_info"], said["worn_level"] = message.status.word, message.status.worn_level
    return said | _event(message) if isinstance(message, messages.Event) else said


def _described(frame: Frame) -> dict[str, Any]:
    said = _said(protocol.decode(frame))
    said["msg_id"] = said.get("message_id", said.get("request_id", frame.message_id))
    said["payload"], said["dlc"] = frame.payload.hex(), len(frame.payload)
    return said | {"terminator": frame.terminator.name}


@pytest.mark.parametrize("name", _SINGLE_FRAMES)
def test_a_vector_decodes_to_all_that_it_expects(name: str) -> None:
    (frame,) = FrameParser().feed(_VECTORS[name].data)
    assert len(frame.payload) + 5 == len(_VECTORS[name].data)
    described, expected = _described(frame), _VECTORS[name].expected
    assert {key: described[key] for key in expected} == expected


@pytest.mark.parametrize("name", [name for name in _VECTORS if name not in _SINGLE_FRAMES])
def test_a_damaged_stream_gives_the_frames_behind_the_damage(name: str) -> None:
    parser, expected = FrameParser(), _VECTORS[name].expected
    found = parser.feed(_VECTORS[name].data) + parser.give_up()
    frames = [[frame.message_id, frame.payload.hex()] for frame in found]
    described = {"frames": frames, "last_frame": frames[-1]}
    assert expected
    assert {key: described[key] for key in expected} == expected


@pytest.mark.parametrize("name", [name for name in _VECTORS if name.startswith("cmd_")])
def test_requests_are_the_bytes_of_their_vector(name: str) -> None:
    assert _REQUESTS[name].hex() == _VECTORS[name].data.hex()


def _stamped(year: int, month: int, day: int, ms: int) -> messages.Header:
    header = struct.pack("<BHBBI", 200, year, month, day, ms)
    message = _only(request(MessageId.RR, header + bytes(36)))
    assert isinstance(message, messages.RrIntervals)
    return message.header


def test_a_day_ends_one_millisecond_before_midnight() -> None:
    before, after = _stamped(2023, 12, 31, 86_399_999), _stamped(2024, 1, 1, 0)
    assert _stamp(before)["time"] == "2023-12-31T23:59:59.999"
    assert _stamp(after)["time"] == "2024-01-01T00:00:00.000"


@pytest.mark.parametrize(
    ("date", "ms"),
    [
        *[((0, 0, 0), 0), ((0, 1, 1), 5000), ((10_000, 1, 1), 0), ((65_535, 255, 255), 0)],
        *[((3000, 1, 1), 0), ((9450, 3, 21), 11_198_744)],
        *[((2026, 0, 1), 0), ((2026, 13, 1), 0), ((2026, 1, 0), 0), ((2026, 2, 29), 0)],
        *[((2026, 1, 31), 86_400_000), ((2026, 1, 31), 2**32 - 1), ((9999, 12, 31), 86_400_000)],
    ],
)
def test_an_impossible_stamp_is_no_time(date: tuple[int, int, int], ms: int) -> None:
    header = _stamped(*date, ms)
    assert (header, header.device_s) == (messages.Header(200, None), None)


@settings(deadline=None)
@given(st.dates(max_value=dt.date(2999, 12, 31)), st.integers(0, 86_399_999))
def test_device_seconds_count_from_2000(date: dt.date, ms: int) -> None:
    days = (date - dt.date(2000, 1, 1)).days
    header = _stamped(date.year, date.month, date.day, ms)
    device_s = pytest.approx(days * 86_400 + ms / 1000, rel=0, abs=1e-4)
    assert (header.sequence, header.device_s) == (200, device_s)


@pytest.mark.parametrize("version", [0, 1, 4, 255])
def test_a_summary_of_another_version_says_nothing(version: int) -> None:
    packet = request(MessageId.SUMMARY, bytes((*_HEADER, version, *bytes(61))))
    assert _only(packet) == messages.Unknown(MessageId.SUMMARY)


def _bits(table: tuple[tuple[str, int], ...]) -> st.SearchStrategy[dict[str, int]]:
    numbers = {name: st.integers(0, 2**n - 1) | st.just(2**n // 2) for name, n in table}
    return st.fixed_dictionaries(numbers)


def _packed(values: dict[str, int], table: tuple[tuple[str, int], ...], size: int) -> bytes:
    text = "".join(f"{values[name]:0{width}b}" for name, width in reversed(table))
    return int(text, 2).to_bytes(size, "little")


@settings(deadline=None)
@given(_bits(messages.GPS), st.integers(0, 0x3FFF), _bits(messages.MOVEMENT))
def test_version_3_bit_fields(gps: dict[str, int], speed: int, movement: dict[str, int]) -> None:
    packed = {39: _packed(gps, messages.GPS, 10), 49: struct.pack("<H", speed | 0xC000)}
    packed[51] = _packed(movement, messages.MOVEMENT, 20)
    hundredths = ("avg_rate_of_force", "avg_step_impulse", "last_jump_flight_s")
    scaled = {name: movement[name] / 100 for name in hundredths}
    scaled["avg_step_period_s"] = movement["avg_step_period_s"] / 1000
    signed = {"peak_accel_theta": (movement["peak_accel_theta"] + 512) % 1024 - 512}
    gps["speed"] = speed
    assert _summary(3, packed).extra == {"gps": gps, "movement": movement | scaled | signed}


def test_version_3_bit_fields_have_the_documented_widths() -> None:
    assert [width for _, width in messages.GPS] == [7, 6, 14, 1, 8, 6, 14, 1, 1, 15, 6]
    movement = [width for _, width in messages.MOVEMENT]
    assert movement == [20, 18, 18, 10, 10, 10, 10, 12, 10, 10, 8, 8, 10]


@pytest.mark.parametrize(("version", "status_at"), [(2, 56), (3, 32)])
def test_the_status_word_zero_means_worn_and_reliable(version: int, status_at: int) -> None:
    status = _summary(version, {status_at: b"\x00\x00"}, fill=0xFF).status
    assert (status.word, status.worn_level, status.worn) == (0, 0, True)
    assert not any(status.flags.values())


def test_the_status_word_names_every_flag() -> None:
    names = ["button", "not_fitted", "hr_unreliable", "rr_unreliable", "skin_temp_unreliable"]
    names += ["posture_unreliable", "activity_unreliable", "hrv_unreliable", "core_temp_unreliable"]
    for bit, name in enumerate(names, start=2):
        status = _summary(2, {56: struct.pack("<H", 1 << bit)}).status
        assert [flag for flag, is_set in status.flags.items() if is_set] == [name]


def test_worn_level_and_state_of_the_wearer() -> None:
    for level, state in enumerate(("invalid", "green", "orange", "red")):
        summary = _summary(2, {40: bytes((level,)), 56: bytes((level,))})
        assert (summary.rog_status, summary.status.worn_level) == (state, level)
        assert summary.status.worn == (level != 3)


def test_invalid_patterns_are_none_in_both_versions() -> None:
    lowest = {"h": b"\x00\x80", "b": b"\x80"}
    for version, (table, _, _) in messages.SUMMARY_LAYOUTS.items():
        changes = {item.offset: lowest[item.code] for item in table if item.code in lowest}
        assert set(_summary(version, changes, fill=0xFF).numbers.values()) == {None}


def test_the_documented_general_packet() -> None:
    payload = _HEADER + bytes.fromhex(
        "8400ad006501e7ff0001a702400fb0044809dd04adffc904f6ff1400fbff2c0000000a000000000001005780"
    )
    message = _only(request(MessageId.GENERAL, payload))
    assert isinstance(message, messages.General)
    numbers = list(message.numbers.values())
    assert numbers[:10] == [132, 17.3, 35.7, -25, 2.56, 6.79, 3.904, 1200, 0.002376, 0.001245]
    assert numbers[10:] == [-0.83, 12.25, -0.1, 0.2, -0.05, 0.44, 0, 10, 1, 0]
    assert (message.battery_percent, message.worn, message.external_sensors) == (87, True, False)


def test_acceleration_in_100_mg_is_signed() -> None:
    packed = sum((value & 0x3FF) << 10 * k for k, value in enumerate([-512, -1, 511] * 20))
    message = _only(request(MessageId.ACCELERATION_100MG, _HEADER + packed.to_bytes(75, "little")))
    assert isinstance(message, messages.Acceleration)
    assert message.samples == ((-512, -1, 511),) * 20
    assert (message.zero, message.counts_per_g) == (0, 10)


def test_a_refused_request_is_told_from_an_accepted_one() -> None:
    for packet in set(Request) - {Request.LIFESIGN}:
        reply = request(packet)[:-1]
        assert _only(reply + b"\x15") == messages.Reply(packet, accepted=False, data=b"")
        assert _only(reply + b"\x06") == messages.Reply(packet, accepted=True, data=b"")
        assert _only(reply + b"\x03") == messages.Unknown(packet), "an echo is no answer"


@pytest.mark.parametrize("code", _EVENTS)
def test_an_event_keeps_its_code_and_data(code: int) -> None:
    event = _only(request(MessageId.EVENT, _HEADER + struct.pack("<HB", code, 5)))
    assert isinstance(event, messages.Event)
    assert (event.code, event.name, event.data) == (code, _EVENTS[code], b"\x05")


def test_recorded_intervals_change_with_their_sign_at_every_beat() -> None:
    packets = [item for item in _recorded(_150S) if isinstance(item, messages.RrIntervals)]
    pairs = list(pairwise(sample for packet in packets for sample in packet.samples))
    changes = [before != after for before, after in pairs]
    assert sum(changes) == 178
    assert changes == [(before < 0) != (after < 0) for before, after in pairs]


def test_recorded_variability_is_there_exactly_when_it_is_reliable() -> None:
    recorded = _recorded(_150S) + _recorded(_WITH_GAP)
    summaries = [item for item in recorded if isinstance(item, messages.Summary)]
    assert len(summaries) == 269
    missing = [summary.numbers["hrv_ms"] is None for summary in summaries]
    assert missing == [summary.status.flags["hrv_unreliable"] for summary in summaries]


def test_recorded_acceleration_at_rest_is_about_one_g() -> None:
    packets = [item for item in _recorded(_150S) if isinstance(item, messages.Acceleration)]
    counts = np.array([packet.samples for packet in packets]).reshape(-1, 3)
    magnitudes = np.linalg.norm((counts - packets[0].zero) / packets[0].counts_per_g, axis=1)
    assert np.median(magnitudes) == pytest.approx(1, abs=0.1)


# Other devices at the port: they are said to be what they are.
HXM = (Path(__file__).parent / "vectors" / "zephyr_hxm_10_frames.dat").read_bytes()
FRAME_BYTES = 60


class Deaf:
    """A link to what sends a frame once a second and heeds nothing."""

    def __init__(self, frames: Callable[[int], bytes]) -> None:
        self._frames = frames
        self._sent = 0

    async def open(self) -> None: ...

    def write(self, data: bytes) -> None: ...

    async def read(self) -> tuple[bytes, float]:
        await asyncio.sleep(1.0)
        self._sent += 1
        return self._frames(self._sent - 1), asyncio.get_running_loop().time()

    async def close(self) -> None: ...


def hxm(number: int) -> bytes:
    begin = number % 10 * FRAME_BYTES
    return HXM[begin : begin + FRAME_BYTES]


def gps(_number: int) -> bytes:
    return b"$GPGGA,12*7"


def silence(_number: int) -> bytes:
    return b""


@pytest.mark.parametrize(
    ("frames", "reason", "what"),
    [
        (hxm, ProtocolReason.UNSUPPORTED, "a Zephyr HxM, which is not supported"),
        (gps, ProtocolReason.GARBAGE, "not a BioHarness"),
        (silence, ProtocolReason.NO_REPLY, "does not answer"),
    ],
)
async def test_it_is_said_what_answers(
    monkeypatch: pytest.MonkeyPatch,
    frames: Callable[[int], bytes],
    reason: ProtocolReason,
    what: str,
) -> None:
    def answering(_port: object) -> Deaf:
        return Deaf(frames)

    monkeypatch.setattr(module, "byte_link", answering)
    settings = ZephyrSettings.model_validate({"sensor": "zephyr", "unit": "1", "port": "COM7"})
    made = DRIVER.make(settings, NotedSink("zephyr"))()
    with pytest.raises(ProtocolError, match=what) as caught:
        await made.connect()
    assert caught.value.reason is reason
    await made.close()


def test_real_frames_of_it_are_whole() -> None:
    protocol = ZephyrProtocol()
    assert len(protocol.feed(HXM)) == 10
    assert protocol.dropped_bytes == 0


@pytest.mark.parametrize("name", ["BH BHT012345", "BHBHT012345"])
def test_a_paired_bioharness_is_found_by_the_name_of_its_port(name: str) -> None:
    settings = {"unit": "BHT012345", "port": "COM7"}
    assert recognise(SerialPort("COM7", name)) == Found("zephyr", name, settings)


@pytest.mark.parametrize(
    "seen",
    [
        SerialPort("COM7"),
        SerialPort("COM7", "Shimmer3-1234"),
        SerialPort("COM7", "BH BHT012345 2"),
        Advertisement("00:07:80:5A:3E:7E", "BH BHT012345"),
    ],
)
def test_others_are_none(seen: SerialPort | Advertisement) -> None:
    assert recognise(seen) is None
