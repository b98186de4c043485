"""What has piled up, behind a cut or in a node that stood still, reaches its subscribers whole."""

from __future__ import annotations

import signal
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
import pylsl
from std_msgs.msg import Float32MultiArray

if TYPE_CHECKING:
    from tests.ros.conftest import Ros, RunningNode

TOPIC = "/biosensors/backlog/EEG"
# The publisher's queue holds the messages of half a minute, at 50 Hz those of 1500 samples.
RATE_HZ, SAMPLES = 50.0, 6000


def test_a_backlog_longer_than_the_publisher_s_queue_arrives_whole(
    ros: Ros, start_node: Callable[..., RunningNode]
) -> None:
    node = start_node()
    outlet = pylsl.StreamOutlet(
        pylsl.StreamInfo("backlog", "EEG", 1, RATE_HZ, "float32", "id of backlog")
    )
    heard: list[Any] = ros.listen(Float32MultiArray, TOPIC)
    ros.attached(TOPIC, readers=1)
    node.send(signal.SIGSTOP)
    numbers = np.arange(SAMPLES, dtype=np.float32)
    stamps = pylsl.local_clock() - (SAMPLES - numbers.astype(np.float64)) / RATE_HZ
    outlet.push_chunk(numbers[:, np.newaxis], stamps.tolist())
    ros.spin(1.0)
    node.send(signal.SIGCONT)
    ros.until(lambda: bool(heard) and heard[-1].data[0] == SAMPLES - 1, "the newest sample")
    assert [message.data[0] for message in heard] == numbers.tolist()
