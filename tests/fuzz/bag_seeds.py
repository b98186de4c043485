"""Bags to begin with."""

from __future__ import annotations

import json
import sqlite3
import tempfile
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np

from tests.bags import made, mcap_bytes
from tests.xdf import xdf_file

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
