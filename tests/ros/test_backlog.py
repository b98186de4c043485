"""What has piled up, behind a cut or in a node that stood still, reaches its subscribers whole."""

from __future__ import annotations

import signal
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
import pylsl
import pytest
from std_msgs.msg import Float32MultiArray

if TYPE_CHECKING:
    from tests.ros.conftest import Ros, RunningNode

pytestmark = pytest.mark.nightly

TOPIC = "/biosensors/backlog/EEG"
# The publisher's queue holds the messages of half a minute, at 50 Hz those of 1500 samples.
RATE_HZ, SAMPLES = 50.0, 6000
DEADLINE_S = 90.0


def play(ros: Ros, node: RunningNode, outlet: pylsl.StreamOutlet) -> list[float]:
    """Send so much that it waits in a node that stands still, which then goes on."""
    node.send(signal.SIGSTOP)
    numbers = np.arange(SAMPLES, dtype=np.float32)
    stamps = pylsl.local_clock() - (SAMPLES - numbers.astype(np.float64)) / RATE_HZ
    outlet.push_chunk(numbers[:, np.newaxis], stamps.tolist())
    ros.spin(1.0)
    node.send(signal.SIGCONT)
    return numbers.tolist()


def counted(ros: Ros) -> int:
    """Return how many samples the node says that its subscribers did not take."""
    status = ros.status(TOPIC)
    assert status is not None
    return int(status["not_taken"])


def test_a_backlog_longer_than_the_publisher_s_queue_arrives_whole(
    ros: Ros, start_node: Callable[..., RunningNode]
) -> None:
    node = start_node()
    outlet = pylsl.StreamOutlet(
        pylsl.StreamInfo("backlog", "EEG", 1, RATE_HZ, "float32", "id of backlog")
    )
    heard: list[Any] = ros.listen(Float32MultiArray, TOPIC)
    ros.attached(TOPIC, readers=1)
    not_taken, is_whole = 0, False
    deadline_s = time.monotonic() + DEADLINE_S
    # A subscriber on a busy machine may not take all that waits for it; the node counts that,
    # and such a round says nothing.
    while not is_whole:
        assert time.monotonic() < deadline_s, f"{not_taken} samples were not taken"
        heard.clear()
        numbers = play(ros, node, outlet)
        newest = numbers[-1]
        ros.until(lambda newest=newest: bool(heard) and heard[-1].data[0] == newest, "the newest")
        ros.report()
        before, not_taken = not_taken, counted(ros)
        is_whole = [message.data[0] for message in heard] == numbers
        assert is_whole or not_taken > before
