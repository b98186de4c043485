"""Lines to an output that is held: nobody waits, nothing is mixed up, what is missing is said."""

from __future__ import annotations

import threading

import pytest

from biosensor_common.nonblocking_writer import NonblockingWriter

pytestmark = pytest.mark.nightly

DEADLINE_S = 30.0


class Held:
    """An output that takes nothing until it is released."""

    def __init__(self) -> None:
        self.lines: list[bytes] = []
        self.ended = 0
        self.is_released, self.is_asked = threading.Event(), threading.Event()

    def write(self, lines: bytes) -> None:
        self.is_asked.set()
        assert self.is_released.wait(DEADLINE_S)
        self.lines.append(lines)

    def end(self) -> None:
        self.ended += 1

    def writer(self, most_bytes: int) -> NonblockingWriter:
        """Return one whose thread stands in the write of a first line."""
        writer = NonblockingWriter("disk", self.write, end=self.end, most_bytes=most_bytes)
        writer.put(b"first\n")
        assert self.is_asked.wait(DEADLINE_S)
        return writer


@pytest.fixture
def held() -> Held:
    return Held()


def test_what_does_not_fit_is_counted_in_its_place(held: Held) -> None:
    writer = held.writer(most_bytes=12)
    # Once it was full it takes nothing, however short, until half of it is gone.
    for line in (b"1\n", b"2345\n", b"two\nlines too many\n", b"3\n"):
        writer.put(line)
    held.is_released.set()
    assert writer.flush(DEADLINE_S)
    writer.put(b"4\n")
    assert writer.close(DEADLINE_S)
    said = b"[3 lines are missing here: the disk took no output]\n"
    assert held.lines == [b"first\n", b"1\n", b"2345\n", said, b"4\n"]
    assert held.ended == 1


def test_what_is_missing_at_the_end_is_said_as_well(held: Held) -> None:
    writer = held.writer(most_bytes=2)
    writer.put(b"1\n")
    writer.put(b"2\n")
    held.is_released.set()
    assert writer.close(DEADLINE_S)
    said = b"[1 line is missing here: the disk took no output]\n"
    assert held.lines == [b"first\n", b"1\n", said]


def test_a_line_that_is_longer_than_the_queue_goes_through_alone(held: Held) -> None:
    writer = held.writer(most_bytes=2)
    writer.put(b"much too long\n")
    held.is_released.set()
    assert writer.close(DEADLINE_S)
    assert held.lines == [b"first\n", b"much too long\n"]


def test_a_held_output_ends_nobody_s_patience_twice(held: Held) -> None:
    writer = held.writer(most_bytes=100)
    assert writer.held_for_s > 0
    assert not writer.flush(0.01)
    assert not writer.close(0.01)
    # It would wait for ever if it counted.
    assert not writer.close(threading.TIMEOUT_MAX)
    assert held.ended == 0
    held.is_released.set()


@pytest.mark.seam
def test_lines_of_many_threads_stay_whole_and_each_in_its_order() -> None:
    lines: list[bytes] = []
    writer = NonblockingWriter("disk", lines.append)

    def put(name: int) -> None:
        for number in range(500):
            writer.put(b"%d %d\n" % (name, number))

    threads = [threading.Thread(target=put, args=[name]) for name in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert writer.close(DEADLINE_S)
    assert writer.held_for_s == 0.0
    for name in range(4):
        own = [line for line in lines if line.startswith(b"%d " % name)]
        assert own == [b"%d %d\n" % (name, number) for number in range(500)]


@pytest.mark.parametrize("refusal", [BrokenPipeError(), ValueError("write to closed file")])
def test_an_output_that_refuses_is_tried_again_with_the_next_line(refusal: Exception) -> None:
    lines: list[bytes] = []

    def write(line: bytes) -> None:
        if line == b"bad\n":
            raise refusal
        lines.append(line)

    writer = NonblockingWriter("disk", write)
    for line in (b"good\n", b"bad\n", b"better\n"):
        writer.put(line)
    assert writer.close(DEADLINE_S)
    assert lines == [b"good\n", b"better\n"]
