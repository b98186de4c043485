"""What a configured publisher of ROS sends on the wire, and what an ordinary one does beside it.

``python -m tests.rigs.rtps_wire RANGE`` as root in a network of its own, which it listens to: both
publish one message to a subscriber that is held, so that they ask it again and again. It prints,
for each, how many of its messages, questions and announcements went over UDP.
"""

from __future__ import annotations

import json
import os
import signal
import socket
import struct
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from typing import NamedTuple

CONFIGURED, ORDINARY = "configured", "ordinary"
# The first question of the ordinary one after which everything counts, and the last one.
FIRST, LAST = 2, 5

_PROGRAM = """
import pathlib, os, sys, time
import rclpy
from rclpy.qos import QoSProfile
from std_msgs.msg import String
from lsl_to_ros import ros_environment
name, topics = sys.argv[1], sys.argv[2:]
if name == "configured":
    rmw = rclpy.get_rmw_implementation_identifier()
    generation = ros_environment.fast_dds_generation()
    assert ros_environment.configure_fast_dds(os.environ, pathlib.Path("/"), rmw, generation)
rclpy.init(args=[])
node = rclpy.create_node(name)
ends = [node.create_subscription(String, topic, print, QoSProfile(depth=1)) for topic in topics]
ends = ends or [node.create_publisher(String, "of_" + name, QoSProfile(depth=1))]
count = "get_publisher_count" if topics else "get_subscription_count"
while not all(getattr(end, count)() for end in ends):
    time.sleep(0.05)
print("matched", flush=True)
sys.stdin.readline()
if not topics:
    ends[0].publish(String(data="said by " + name))
sys.stdin.read()
"""
# Ids of RTPS, version 2.2, chapters 8.3.7, 9.3.1.3 and 9.4.5.
_HEADER, _DATA, _HEARTBEAT = 20, 0x15, 0x07
_ANNOUNCEMENTS = bytes.fromhex("000100c2")
_UDP_HEADERS, _OUTGOING = 14 + 20 + 8, 4


class Sent(NamedTuple):
    """A part of an RTPS packet that a writer has sent."""

    participant: bytes
    writer: bytes
    kind: int
    to: bytes
    content: bytes


def parts(frame: bytes) -> Iterator[Sent]:
    """Take an Ethernet frame with an RTPS packet apart; nothing of any other one."""
    packet = frame[_UDP_HEADERS:]
    if packet[:4] != b"RTPS":
        return
    participant, at = packet[8:_HEADER], _HEADER
    # Address and port, of the headers of IP and UDP.
    to = frame[30:34] + frame[36:38]
    while at + 4 <= len(packet):
        kind, flags = packet[at], packet[at + 1]
        (length,) = struct.unpack("<H" if flags & 1 else ">H", packet[at + 2 : at + 4])
        content = packet[at + 4 : at + 4 + length] if length else packet[at + 4 :]
        if kind in {_DATA, _HEARTBEAT}:
            writer = content[8:12] if kind == _DATA else content[4:8]
            yield Sent(participant, writer, kind, to, content)
        at += 4 + len(content)


class Counts:
    """Counts what each of the two sends from the ordinary one's ``FIRST`` question on."""

    def __init__(self) -> None:
        self._names: dict[bytes, str] = {}
        self._writers: dict[str, bytes] = {}
        self._asked = Counter[str]()
        self.messages = Counter[str]()
        self.questions = Counter[str]()
        self._announcements = Counter[tuple[str, bytes]]()

    def add(self, sent: Sent) -> None:
        if sent.kind == _DATA:
            for name in (CONFIGURED, ORDINARY):
                if f"said by {name}".encode() in sent.content:
                    self._names[sent.participant], self._writers[name] = name, sent.writer
                    self.messages[name] += 1
        name = self._names.get(sent.participant)
        if name is None:
            return
        if sent.kind == _HEARTBEAT and sent.writer == self._writers[name]:
            self._asked[name] += 1
            self.questions[name] += self._counts
        elif sent.kind == _DATA and sent.writer == _ANNOUNCEMENTS:
            self._announcements[name, sent.to] += self._counts

    @property
    def _counts(self) -> bool:
        """Not before: a participant that has just started announces itself more often."""
        return self._asked[ORDINARY] >= FIRST

    @property
    def are_complete(self) -> bool:
        return self._asked[ORDINARY] >= LAST and bool(self.messages[CONFIGURED])

    def of(self, name: str) -> dict[str, int]:
        # To one address: an announcement goes to many.
        to_one = [count for (of, _), count in self._announcements.items() if of == name]
        return {
            "messages": self.messages[name],
            "questions": self.questions[name],
            "announcements": max(to_one, default=0),
        }


def main(range_: str) -> None:
    """Start the three programs, hold the subscriber, publish, and listen."""
    ordinary = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET", "FASTDDS_BUILTIN_TRANSPORTS": "UDPv4"}
    subscriber = _start("subscriber", f"of_{CONFIGURED}", f"of_{ORDINARY}", **ordinary)
    publishers = [
        _start(CONFIGURED, ROS_AUTOMATIC_DISCOVERY_RANGE=range_),
        _start(ORDINARY, **ordinary),
    ]
    programs = [subscriber, *publishers]
    try:
        for program in programs:
            assert program.stdout is not None
            assert program.stdout.readline() == b"matched\n"
        subscriber.send_signal(signal.SIGSTOP)
        # Not before: what they say until they have found each other may fill what is not read yet.
        listening = socket.socket(socket.AF_PACKET, socket.SOCK_RAW, socket.htons(3))
        listening.bind(("lo", 0))
        for program in publishers:
            assert program.stdin is not None
            program.stdin.write(b"\n")
            program.stdin.flush()
        counts = Counts()
        while not counts.are_complete:
            frame, (_, _, direction, *_) = listening.recvfrom(65536)
            # Each comes twice on a loopback.
            if direction == _OUTGOING:
                for sent in parts(frame):
                    counts.add(sent)
    finally:
        for program in programs:
            program.kill()
            program.wait()
    print(json.dumps({name: counts.of(name) for name in (CONFIGURED, ORDINARY)}))


def _start(name: str, *topics: str, **variables: str) -> subprocess.Popen[bytes]:
    return subprocess.Popen(
        [sys.executable, "-c", _PROGRAM, name, *topics],
        env=os.environ | variables,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
    )


if __name__ == "__main__":
    main(sys.argv[1])
