"""Seeds for what people and other programs write: texts, descriptions and recordings."""

from __future__ import annotations

import gzip
import json
import re
import sqlite3
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
from rclpy.serialization import serialize_message

from biosensor_common.lsl_header import describe
from biosensor_common.naming import lsl_name, source_id
from biosensor_common.spec import DeviceIdentity, DeviceInfo, FromDevice, StreamSpec
from biosensor_gateway.devices.registry import declaration, settings_models
from biosensor_gateway.settings.editor import template
from lsl_to_ros.ros_to_lsl.class_fields import message_class
from tests.bags import made, mcap_bytes
from tests.fuzz.streams import join_counted
from tests.fuzz.targets.ros_to_lsl import CLASSES
from tests.xdf import xdf_file

Seeds = Iterator[tuple[str, bytes]]

_SENSORS = ("zephyr", "polar_h10", "empatica_e4", "emotiv_insight", "gateway")
_ODD_FIELDS = {
    "channel_count": ("0", "-1", "4097", "1.5", " 1 ", "9" * 5000),
    "nominal_srate": ("inf", "nan", "-1", "1e400", "1_0", ""),
    "channel_format": ("int64", "undefined", ""),
    "name": ("", "\u00e4 b", "_x0"),
    "type": ("", "a_chunk"),
}
_ODD_MEANINGS = (
    (">state_of_charge<", ">blood_pressure<"),
    (">state_of_charge<", ">contact<"),
    (">state_of_charge<", f">{'r' * 5000}<"),
    (">percent<", ">mmHg<"),
    (">true<", ">maybe<"),
    (">true<", "><"),
    ("<is_state>true</is_state>", "<is_state>true</is_state>" * 2),
    ("<nominal_srate>0", "<nominal_srate>7"),
)
_COUNTS = {"pushed": 1280, "lost": 3, "last_stamp": 5012.25}


def _identity(name: str) -> DeviceIdentity:
    return DeviceIdentity(name, "A1B2", participant="p01", label="left")


def _description(stream: StreamSpec, identity: DeviceIdentity) -> ET.Element:
    return describe(stream, identity, DeviceInfo("maker", "model", "A1B2", "1.2"))


def _info(stream: StreamSpec, identity: DeviceIdentity) -> ET.Element:
    """Return what LSL itself says of a stream."""
    info = ET.Element("info")
    rate = 50.0 if isinstance(stream.rate, FromDevice) else stream.rate
    for tag, text in {
        "name": lsl_name(identity, stream.data_name),
        "type": stream.content_type.value,
        "channel_count": str(len(stream.channels)),
        "channel_format": stream.format.value,
        "source_id": source_id(identity, stream.data_name),
        "nominal_srate": repr(rate),
        "hostname": "lab",
    }.items():
        ET.SubElement(info, tag).text = text
    return info


def _described(name: str, data_name: str) -> bytes:
    stream, identity = declaration(name).stream(data_name), _identity(name)
    info = _info(stream, identity)
    info.append(_description(stream, identity))
    return ET.tostring(info)


def _headers() -> Seeds:
    foreign = b""
    for name in _SENSORS:
        for stream in declaration(name).streams:
            yield f"{name}_{stream.data_name}", _described(name, stream.data_name)
            foreign = ET.tostring(_info(stream, _identity(name)))
            yield f"{name}_{stream.data_name}_foreign", foreign
    yield from _odd_meanings()
    for tag, texts in _ODD_FIELDS.items():
        for number, text in enumerate(texts):
            odd = re.sub(f"<{tag}>.*?</{tag}>", f"<{tag}>{text}</{tag}>", foreign.decode())
            yield f"odd_{tag}_{number}", odd.encode()


def _odd_meanings() -> Seeds:
    """Roles and states that are unknown, do not fit, or come twice."""
    sound = _described("zephyr", "bat").decode()
    for number, (old, new) in enumerate(_ODD_MEANINGS):
        yield f"odd_meaning_{number}", sound.replace(old, new).encode()


def _names() -> Seeds:
    plain = ["zephyr", "ECG", "A1", "lab", "zephyr_left", "ECG", "A1", "lab"]
    yield "two_streams", "\n".join(plain).encode()
    yield "units", b"zephyr\nA1\n\n\nzephyr\nA2\n\n\nzephyr\nA1\np01\n\nzephyr\nA1\np01\nleft"
    yield "odd_bytes", b"_x0\n__\nx0x\n\xff\xfe\n1st\n/a/b\n hr_chunk\n\xc3\xa4\n"
    yield "long", b"\n".join((b"a" * 63, b"a" * 64, b"a" * 65, b"_" * 70))


def _settings() -> Seeds:
    for name, model in settings_models().items():
        text = template({name: model})
        yield f"template_{name}", text.encode()
        # The template has its settings behind comment signs.
        shown = "\n".join(line.removeprefix("# ") for line in text.splitlines() if " = " in line)
        yield f"set_{name}", f'[[device]]\nsensor = "{name}"\nunit = "a"\n{shown[:1500]}'.encode()
    yield (
        "sections",
        (
            b'[lsl]\nsession_id = "study7"\nknown_peers = ["10.0.0.7"]\nport_range = 300\n'
            b'[log]\nlevel = "debug"\n[power]\nkeep_awake = false\n'
        ),
    )
    yield "wrong", b'lsl.port_range = 0x1_0000\n[log]\nlevel = """loud"""\nsize = {a = [1, {b=2}]}'
    yield (
        "odd_strings",
        (
            b"a = '''x''''\nb = '''\ny]'''''\nc = [\"\"\"\\\"]\"\"\"\"\", 1, # ]\n 2]\n"
            b'"d.e"."\\u0066" = {g = "}", h = [{}]}\n[["i j".k]]\n[["i j".k]]\n'
            b"l = 1979-05-27T07:32:00Z\n"
        ),
    )
    yield "twins", b'[[device]]\nsensor="zephyr"\nunit="a"\n[[device]]\nsensor="zephyr"\nunit="a"\n'


def _lsl_configs() -> Seeds:
    yield "odd_empty", b""
    yield (
        "usual",
        (
            b"; ours\n[lab]\nSessionID = study7\nKnownPeers = {10.0.0.7, lab-pc.local}\n"
            b"[ports]\nBasePort = 16572\nPortRange = 32\nMulticastPort = 16571\n"
            b"[multicast]\nResolveScope = site\nAddressesOverride = {224.0.0.183}\n"
            b"[log]\nlevel = -1\n"
        ),
    )
    yield "windows", b"[lab]\r\nSessionID=a\r\n\r\n[ports]\r\nPortRange=300\r\n"
    yield "hash", b"# no comment to LSL\n[lab]\nSessionID = a\n"
    yield "twice", b"[ports]\nPortRange = 1\n[lab]\n[ports]\nPortRange = 2\nIPv6 = allow\n"
    yield "continued", b"[lab]\nKnownPeers = {a,\n  b}\n"
    yield "bom", b"\xef\xbb\xbf[lab]\nSessionID = a\n"


def _status() -> Seeds:
    device = {"sensor": "zephyr", "unit": "a", "state": "streaming", "streams": {"s": _COUNTS}}
    yield "running", json.dumps({"written": 4e9, "process": 1, "devices": [device]}).encode()
    yield "stale", json.dumps({"written": 1.0, "process": 1, "devices": []}).encode()
    yield "odd_empty", b""
    yield "odd_cut", b'{"written": 4e9, "process'


def _counters() -> Seeds:
    yield "usual", json.dumps({"zephyr-A1-ecg": _COUNTS, "zephyr-A1-hr": _COUNTS}).encode()
    yield "none", b"{}"
    yield "odd_nan", b'{"a":{"pushed":1,"lost":0,"last_stamp":NaN}}'
    yield "odd_text", b'{"a":{"pushed":"1","lost":0,"last_stamp":1e400}}'


def _requests() -> Seeds:
    yield "echo", b'{"token": "TOKEN", "command": "echo", "arguments": {"a": 1}}\n'
    yield "odd_no_token", b'{"command": "echo", "arguments": {}}\n'
    yield "unknown", b'{"token": "TOKEN", "command": "stop"}\n'
    yield "odd_types", b'{"token": "TOKEN\\ud800", "command": ["echo"], "arguments": 7}\n'
    yield "odd_nested", b"[" * 3000 + b"\n"
    yield "odd_nested_arguments", b'{"token": "TOKEN", "arguments": ' + b'{"a":' * 600 + b"\n"
    yield "no_end", b'{"token": "TOKEN", "command": "echo"'
    yield "odd_protocol", b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n"


def _recordings() -> Seeds:
    stamps = [100.0 + at / 50 for at in range(30)]
    good = xdf_file.regular(1, "acc", [*stamps, 105.0, 105.02], 50.0)
    yield "good", xdf_file.xdf(*good, xdf_file.boundary())
    yield "packed", gzip.compress(xdf_file.xdf(*good), mtime=0)
    yield "damaged", xdf_file.xdf(good[0], good[1][:99], xdf_file.boundary(), good[2])
    for fmt in xdf_file.DTYPES:
        yield (
            fmt,
            xdf_file.xdf(
                xdf_file.stream_header(1, "a", channels=2, rate=10.0, fmt=fmt),
                xdf_file.samples(1, fmt, [[1, 2], [3, 4], [5, 6]], [100.0, None, 100.2]),
                xdf_file.clock_offset(1, 100.0, 0.25),
                xdf_file.clock_offset(1, 105.0, 0.26),
                xdf_file.footer(1, 3),
            ),
        )
    yield (
        "text",
        xdf_file.xdf(
            xdf_file.stream_header(2, "marks", fmt="string"),
            xdf_file.samples(2, "string", [["go"], ["\xe4"]], [100.0, 101.0]),
            xdf_file.footer(2, None),
        ),
    )
    yield "ours", xdf_file.xdf(*_own())
    # Longer than a section of the exporters as they are fuzzed.
    even = [100.0 + at / 100 for at in range(600)]
    late = [100.0 + (at // 40 + 1) * 0.4 for at in range(600)]
    yield "gaps", xdf_file.xdf(*_ecg([at + 5 * (at > 101) + 9 * (at > 112.99) for at in even]))
    yield "bursts", xdf_file.xdf(*_ecg(late))
    yield "set_back", xdf_file.xdf(*_ecg([at - 3 * (at > 102) for at in even]))


def _ecg(stamps: Sequence[float]) -> Iterator[bytes]:
    yield xdf_file.stream_header(1, "ecg", kind="ECG", rate=100.0)
    for begin in range(0, len(stamps), 40):
        part = stamps[begin : begin + 40]
        yield xdf_file.samples(1, "float32", [[at % 1] for at in part], part)
        yield xdf_file.clock_offset(1, part[0], 0.25)
    yield xdf_file.footer(1, len(stamps))


def _own() -> Iterator[bytes]:
    """Streams of the agent, with the counters that it keeps of them."""
    device, agent = DeviceIdentity("zephyr", "A1"), DeviceIdentity("gateway", "A1")
    ecg = source_id(device, "ecg")
    text = json.dumps({ecg: {"pushed": 3, "lost": 1, "last_stamp": 100.008}})
    for number, (owner, data, rate, fmt, rows) in enumerate(
        (
            (device, "ecg", 250.0, "float32", [[1.0], [2.0], [3.0]]),
            (agent, "counters", 1.0, "string", [[text], [text], [text]]),
        ),
        start=1,
    ):
        stream = declaration(owner.sensor).stream(data)
        yield xdf_file.stream_header(
            number,
            lsl_name(owner, data),
            kind=stream.content_type.value,
            rate=rate,
            fmt=fmt,
            source_id=source_id(owner, data),
            desc=_description(stream, owner),
        )
        yield xdf_file.samples(number, fmt, rows, [100.0, 100.004, 100.008])
        yield xdf_file.footer(number, 3)


def seeds() -> dict[str, Seeds]:
    """Return the seeds of each target, with their names."""
    return {
        "control_request": _requests(),
        "counters": _counters(),
        "lsl_config": _lsl_configs(),
        "lsl_header": _headers(),
        "naming": _names(),
        "ros_to_lsl": asked_and_sent(),
        "settings": _settings(),
        "status": _status(),
        "bags": bags(),
        "xdf": _recordings(),
        "xdf_export": _recordings(),
    }


# Bags to begin with.

_TYPES = made.typestore().types
_BEGIN_S = 1_790_000_000
_HEADER = _TYPES["std_msgs/msg/Header"](
    _TYPES["builtin_interfaces/msg/Time"](_BEGIN_S, 5), "zephyr"
)


def bags() -> Iterator[tuple[str, bytes]]:
    """Give a bag of each kind, with its name."""
    floats = [_TYPES["std_msgs/msg/Float32"](number / 4) for number in range(3)]
    raw = mcap_bytes.topic(1, "/biosensors/zephyr/ecg", "std_msgs/msg/Float32", *floats)
    stamped = mcap_bytes.topic(
        2, "/biosensors/zephyr/ecg_stamped", "biosensor_msgs/msg/Samples", *_samples(), latched=True
    )
    yield "numbers", mcap_bytes.file(raw)
    yield "live", mcap_bytes.file(mcap_bytes.chunk(raw, stamped))
    yield "listed", mcap_bytes.file(_listed(), stamped)
    texts = [_TYPES["std_msgs/msg/String"](text) for text in _told()]
    told = mcap_bytes.topic(3, "/biosensors/recorded_streams", "std_msgs/msg/String", *texts)
    yield "recorded", mcap_bytes.file(told, mcap_bytes.chunk(stamped))
    yield "cut", mcap_bytes.file(told, mcap_bytes.chunk(stamped))[:-400]
    said = mcap_bytes.topic(4, "/said", "std_msgs/msg/String", texts[0])
    yield "text", mcap_bytes.file(said)
    joints = _TYPES["sensor_msgs/msg/JointState"](
        _HEADER, ["a", "b"], np.arange(2.0), np.empty(0), np.empty(0)
    )
    yield (
        "joints",
        mcap_bytes.file(
            mcap_bytes.topic(5, "/joints", "sensor_msgs/msg/JointState", joints, joints)
        ),
    )
    yield (
        "odd_definition",
        mcap_bytes.file(
            mcap_bytes.schema(
                1, "a/msg/B", "float64 x\na/C[<=2] y\n" + "=" * 80 + "\nMSG: a/C\nint8 z"
            ),
            mcap_bytes.channel(1, 1, "/b", {}),
            mcap_bytes.message(1, 5, b"\0\1\0\0" + bytes(16)),
        ),
    )
    yield "sqlite", _sqlite()


def _samples() -> list[object]:
    return [
        _TYPES["biosensor_msgs/msg/Samples"](
            _HEADER, at, -1, False, ["ecg"], ["mV"], np.arange(2), np.arange(2.0), np.empty(0, int)
        )
        for at in (0, 2)
    ]


def _listed() -> bytes:
    """Return what the node says of its streams."""
    stamped = "/biosensors/zephyr/ecg_stamped"
    told = {"source_id": "zephyr-ecg", "format": "float32", "labels": "ecg", "units": "mV"}
    told |= {"foreign": "false", "participant": "", "label": "", "lsl_name": "zephyr-U1-ecg"}
    told |= {"lsl_type": "ECG", "host": "pc", "rate": "250", f"topic {stamped}": ""}
    pair = _TYPES["diagnostic_msgs/msg/KeyValue"]
    pairs: list[Any] = [pair(key, value) for key, value in told.items()]
    status = _TYPES["diagnostic_msgs/msg/DiagnosticStatus"](0, stamped, "", "U1", pairs)
    kind = "diagnostic_msgs/msg/DiagnosticArray"
    return mcap_bytes.topic(6, "/lsl_to_ros/streams", kind, _TYPES[kind](_HEADER, [status]))


def _told() -> Iterator[str]:
    recording = {"begun": "", "source": "date", "resolution_s": 1.0, "clock": [[100.0, 10**18]]}
    yield json.dumps({"recording": recording})
    header = xdf_file.stream_header(1, "ecg", rate=250.0)
    stream = {
        "number": 1,
        "stamped": "/biosensors/zephyr/ecg_stamped",
        "topics": ["/biosensors/zephyr/ecg"],
        "header": header[header.index(b"<info") :].decode(),
        "clock_offsets": [[100.0, 0.5]],
    }
    yield json.dumps({"stream": stream})


def _sqlite() -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "a.db3")
        with closing(sqlite3.connect(path)) as database:
            database.executescript(
                "PRAGMA page_size=512;"
                "CREATE TABLE topics(id,name,type,serialization_format,offered_qos_profiles);"
                "CREATE TABLE messages(id,topic_id,timestamp,data);"
                "INSERT INTO topics VALUES(1,'/a','std_msgs/msg/Float32','cdr','');"
                "INSERT INTO messages VALUES(1,1,5,x'000100000000803f');"
            )
        return path.read_bytes()


# Parameters of ``ros_to_lsl`` and messages to begin with.

Pose = message_class("geometry_msgs/msg/Pose")
_PARAMETERS: dict[str, dict[str, Any]] = {
    "whole": {"topics": ["/joint_states"]},
    "groups": {
        "topics": ["/a", "b"],
        "/a.fields": ["position", "pose.pose", "status", "poses[1]", "points"],
        "/a.name": "arm",
        "b.as": "markers",
        "b.type": "std_msgs/msg/String",
        "b.rate": 2.5,
    },
    "by_arrival": {"all_small": True, "stamps": "arrival", "use_sim_time": True},
    "odd_nothing": {"topics": [""], "session_id": "a"},
    "odd_two_of_one_name": {"topics": ["/a/b", "/c"], "/c.name": "a-b"},
    "odd_not_among": {"topics": ["/a"], "/b.rate": 1},
    "odd_two_slashes": {"topics": ["/a//b"]},
    "odd_option": {"topics": ["/a"], "/a.rat": 1},
    "odd_name": {"topics": ["/a"], "/a.name": "a b"},
    "odd_kind": {"topics": ["/a"], "/a.fields": "position"},
    "odd_rate": {"topics": ["/a"], "/a.rate": -1.0},
    "odd_simulated": {"topics": ["/a"], "use_sim_time": True},
    "odd_topic": {"topics": ["/a//b c"]},
}


def asked_and_sent() -> Iterator[tuple[str, bytes]]:
    """Give parameters, each with messages of all types."""
    for name, parameters in _PARAMETERS.items():
        line = json.dumps(parameters).encode()
        if name.startswith("odd_"):
            yield name, line
            continue
        yield name, line + b"\n" + join_counted([_piece(kind()) for kind in CLASSES])
        yield f"{name}_filled", line + b"\n" + join_counted([_piece(each) for each in _filled()])
    for name, joints in (("alike", ["a", "a"]), ("odd_no_xml", ["a\x01", "b\ufffe"])):
        sent = _made("sensor_msgs/msg/JointState", name=joints, position=[1.0, 2.0])
        yield name, b"{}\n" + join_counted([_piece(sent)])


def _filled() -> Iterator[Any]:
    joints = {"name": ["a", "b"], "position": [1.0, 2.0]}
    yield _made("sensor_msgs/msg/JointState", **joints)
    yield _made("sensor_msgs/msg/JointState", **joints, effort=[3.0, 4.0])
    yield _made("sensor_msgs/msg/JointState", name=["a"], position=[float("nan")])
    yield _made("sensor_msgs/msg/JointState")
    yield _made("std_msgs/msg/String", data='he said "ja" \u00e4\u4e16')
    yield _made("std_msgs/msg/UInt64", data=2**64 - 1)
    yield _made("sensor_msgs/msg/BatteryState", power_supply_status=1, cell_voltage=[3.7, 3.8])
    yield _made("std_msgs/msg/ByteMultiArray", data=[b"\x00", b"\xff"])
    yield _made("geometry_msgs/msg/PoseArray", poses=[Pose(), Pose()])
    yield _made("geometry_msgs/msg/PoseArray", poses=[Pose()])
    point = _made("trajectory_msgs/msg/JointTrajectoryPoint", positions=[0.5, 1.5])
    yield _made("trajectory_msgs/msg/JointTrajectory", joint_names=["a", "b"], points=[point] * 2)
    status = _made(
        "diagnostic_msgs/msg/DiagnosticStatus",
        level=b"\x02",
        name="a",
        values=[_made("diagnostic_msgs/msg/KeyValue", key="k", value="v")],
    )
    yield status
    yield _made("diagnostic_msgs/msg/DiagnosticArray", status=[status, status])


def _made(kind: str, /, **fields: Any) -> Any:
    return message_class(kind)(**fields)


def _piece(message: Any) -> bytes:
    return bytes([CLASSES.index(type(message))]) + serialize_message(message)
