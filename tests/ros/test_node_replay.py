"""A replay becomes topics as the live device does, and is called a replay."""

from __future__ import annotations

import threading
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from std_msgs.msg import Float32MultiArray

from biosensor_gateway.recording.contents.choice import Selection, choose
from biosensor_gateway.recording.contents.opening import open_contents
from biosensor_gateway.recording.replay.player import Player, PlayOptions
from tests.recording_contents.ours import description
from tests.replay import files

if TYPE_CHECKING:
    from tests.ros.conftest import Ros

pytestmark = [pytest.mark.nightly, pytest.mark.usefixtures("node")]

RATE_HZ, SECONDS = 128.0, 1.5
TOPIC = "/P1/biosensors/polar_h10/ecg"


@contextmanager
def player(path: Path) -> Generator[Player]:
    ours = description("polar_h10", "ecg", "P1")
    own_events = description("lsl_to_ros", "events")
    files.write(
        path,
        files.regular(1, "P1-polar_h10-u1-ecg", RATE_HZ, SECONDS, source_id="P1@polar_h10-ecg",
                      desc=ours),
        files.texts(2, "lsl_to_ros-u1-events", [0.5], source_id="lsl_to_ros-u1-events",
                    desc=own_events),
    )  # fmt: skip
    with open_contents(path) as contents:
        playing = Player(choose(contents, Selection()), PlayOptions(speed=0.5), "hash")
        playing.offer()
        yield playing


def test_a_replay_is_published_like_the_live_device_and_said_to_be_one(
    ros: Ros, tmp_path: Path
) -> None:
    heard = ros.listen(Float32MultiArray, TOPIC)
    with player(tmp_path / "study.xdf") as playing:
        ros.attached(TOPIC, readers=1)
        playing.run(threading.Event())
        sent = playing.progress().sent - 1
        ros.until(lambda: len(heard) >= sent, "all samples")
        ros.report()
        status = ros.status(TOPIC)
        topics = ros.topics()
        with open_contents(tmp_path / "study.xdf") as contents:
            blocks = list(contents.streams[0].blocks())
    recorded = np.concatenate([np.asarray(each.values) for each in blocks])
    assert [list(each.data) for each in heard] == recorded.tolist()
    assert status is not None
    assert status["replay_of"] == "study.xdf"
    assert status.message.endswith("; a replay of study.xdf at 0.5 times its speed")
    # At half the speed the stamps are half as dense, and the header says so.
    assert float(status["rate_nominal"]) == RATE_HZ / 2
    # No agent counts what is played: losses are estimated by its stamps, which have no gap.
    assert status["lost"] == "about 0"
    assert not [topic for topic in topics if "lsl_to_ros/events" in topic]
