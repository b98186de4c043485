"""Other people's readers find in a bag what was in the recording that it was made of."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path
from typing import Any

import pytest

from biosensor_gateway.recording.bag.conversion import import_bag
from tests.bags import made
from tests.xdf import xdf_file

pytestmark = pytest.mark.nightly

PEERS = Path(__file__).parent
ENVIRONMENT = PEERS.parents[1] / ".venv-peers"
DEADLINE_S = 60.0
STAMPS = [20.0 + n / 250 for n in range(500)]


def _read(bag: Path) -> dict[str, Any]:
    if not (ENVIRONMENT / ".installed").exists():
        pytest.fail("the peers are not installed: run `make venv-peers` first")
    (file,) = bag.glob("*.mcap")
    line = [ENVIRONMENT / "bin" / "python", PEERS / "bag_reads.py", file]
    ended = subprocess.run(line, capture_output=True, text=True, timeout=DEADLINE_S, check=False)
    assert ended.returncode == 0, ended.stderr
    return json.loads(ended.stdout)


def test_mcap_reads_what_was_recorded(tmp_path: Path) -> None:
    ecg, _ = made.declared(1, "zephyr", "ecg", "p01", "left")
    motion, channels = made.declared(2, "emotiv_insight", "mot", "p01")
    button, _ = made.declared(3, "empatica_e4", "tag", "p01")
    parts = [ecg, motion, button]
    for at in range(0, 500, 50):
        values = [[n / 8] for n in range(at, at + 50)]
        parts.append(xdf_file.samples(1, "float32", values, list(STAMPS[at : at + 50])))
    parts.append(xdf_file.samples(2, "float32", [[0.25] * channels], [20.5]))
    parts.append(xdf_file.samples(3, "string", [["\u00e4 \U0001f9e0"]], [20.75]))
    recording = tmp_path / "a.xdf"
    recording.write_bytes(made.dated(*parts))
    made.to_bag(recording, tmp_path / "a")

    read = _read(tmp_path / "a")
    topics = read["topics"]
    base = "/p01/biosensors/zephyr_left"
    raw, stamped = topics[f"{base}/ecg"], topics[f"{base}/ecg_stamped"]
    assert read["count"] == sum(len(each["messages"]) for each in topics.values())
    assert (raw["type"], stamped["type"]) == ("std_msgs/msg/Float32", "biosensor_msgs/msg/Samples")
    assert "reliability: reliable" in raw["qos"]
    assert [message["data"] for _, message in raw["messages"]] == [n / 8 for n in range(500)]
    begin_ns = raw["messages"][0][0]
    for (log_ns, _), stamp in zip(raw["messages"], STAMPS, strict=True):
        assert abs(log_ns - begin_ns - (stamp - STAMPS[0]) * 1e9) <= 1000
    messages = [message for _, message in stamped["messages"]]
    assert [message["sequence"] for message in messages] == list(range(0, 500, 50))
    assert [v for message in messages for v in message["data"]] == [n / 8 for n in range(500)]
    assert messages[0]["labels"] == ["ECG"]
    assert messages[0]["header"]["frame_id"] == "p01/zephyr_left"
    ((_, imu),) = topics["/p01/biosensors/emotiv_insight/mot_imu"]["messages"]
    assert imu["linear_acceleration"]["x"] == pytest.approx(0.25 * 9.80665)
    ((_, event),) = topics["/p01/biosensors/empatica_e4/tag_stamped"]["messages"]
    assert event["data"] == "\u00e4 \U0001f9e0"


def test_mcap_reads_the_same_after_a_way_round(tmp_path: Path) -> None:
    header, _ = made.declared(1, "zephyr", "ecg")
    samples = xdf_file.samples(1, "float32", [[n / 8] for n in range(500)], list(STAMPS))
    (tmp_path / "a.xdf").write_bytes(made.dated(header, samples))
    made.to_bag(tmp_path / "a.xdf", tmp_path / "first")
    import_bag(tmp_path / "first", tmp_path / "b.xdf")
    made.to_bag(tmp_path / "b.xdf", tmp_path / "second")
    first, second = _read(tmp_path / "first")["topics"], _read(tmp_path / "second")["topics"]
    assert first.keys() == second.keys()
    raw = "/biosensors/zephyr/ecg"
    for (old_ns, old), (new_ns, new) in zip(
        first[raw]["messages"], second[raw]["messages"], strict=True
    ):
        assert abs(old_ns - new_ns) <= 1000
        assert old == new
