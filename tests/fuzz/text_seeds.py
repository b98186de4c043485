"""Seeds for what people and other programs write: texts, descriptions and recordings."""

from __future__ import annotations

import gzip
import json
import re
from collections.abc import Iterator, Sequence
from xml.etree import ElementTree as ET

from biosensor_common.lsl_header import describe
from biosensor_common.naming import lsl_name, source_id
from biosensor_common.spec import DeviceIdentity, DeviceInfo, FromDevice, StreamSpec
from biosensor_gateway.devices.registry import declaration, settings_models
from biosensor_gateway.settings.editor import template
from tests.fuzz.bag_seeds import bags
from tests.fuzz.ros_seeds import asked_and_sent
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
