"""When a recording counts as growing, and when as closed."""

from __future__ import annotations

import threading
import time
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

import pytest

from biosensor_gateway.recording.recorder import recording_file
from biosensor_gateway.recording.recorder.recording_file import (
    grows,
    sizes,
    summarize,
    wait_for_growth,
    wait_until_closed,
)
from biosensor_gateway.recording.recorder.request import Target
from tests.xdf.xdf_file import FILE_HEADER, chunk, footer, samples, stream_header

HEAD = b"XDF:" + chunk(1, FILE_HEADER) + stream_header(1, "one")
MORE = samples(1, "float32", [[1.0], [2.0]], [1.0, 2.0])
DEADLINE_S = 30.0
SHORT_S = 1.5


@contextmanager
def written(path: Path, first: bytes, block: bytes) -> Generator[None]:
    """Write a file as a recorder does: block after block, until the context ends."""
    ended = threading.Event()

    def write() -> None:
        with path.open("ab") as file:
            file.write(first)
            file.flush()
            while not ended.wait(0.1):
                file.write(block)
                file.flush()

    writer = threading.Thread(target=write)
    writer.start()
    try:
        yield
    finally:
        ended.set()
        writer.join()


@pytest.mark.nightly
def test_a_file_that_gets_samples_grows(tmp_path: Path) -> None:
    path = tmp_path / "a.xdf"
    with written(path, HEAD, MORE):
        assert wait_for_growth(Target(files=(path,)), {}, DEADLINE_S) == path
        assert grows(path, DEADLINE_S)


@pytest.mark.nightly
def test_headers_alone_are_no_recording(tmp_path: Path) -> None:
    path = tmp_path / "a.xdf"
    with written(path, HEAD, stream_header(2, "two")):
        assert wait_for_growth(Target(files=(path,)), {}, SHORT_S) is None


@pytest.mark.nightly
@pytest.mark.parametrize("content", [b"", b"PK\3\4", HEAD + MORE])
def test_a_file_that_stays_as_it_is_does_not_grow(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "a.xdf"
    path.write_bytes(content)
    assert wait_for_growth(Target(files=(path,)), {}, SHORT_S) is None
    assert not grows(path, 0.5)


@pytest.mark.nightly
def test_in_a_folder_what_was_there_before_is_left_alone(tmp_path: Path) -> None:
    old = tmp_path / "old.xdf"
    old.write_bytes(HEAD + MORE + footer(1, 2))
    target = Target(folder=tmp_path)
    before = sizes(target)
    assert before == {old: old.stat().st_size}
    new = tmp_path / "deep" / "new.XDF"
    new.parent.mkdir()
    with written(tmp_path / "notes.txt", HEAD, MORE):
        assert wait_for_growth(target, before, SHORT_S) is None
    with written(new, HEAD, MORE):
        assert wait_for_growth(target, before, DEADLINE_S) == new


def test_what_is_not_there_does_not_grow(tmp_path: Path) -> None:
    assert wait_for_growth(Target(files=(tmp_path / "a.xdf",)), {}, 0.0) is None
    assert not grows(tmp_path / "a.xdf", 0.0)


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("content", "is_closed"),
    [
        (HEAD + MORE + footer(1, 2), True),
        # LabRecorder cannot record these, and gives them no footer.
        (HEAD + MORE + footer(1, 2) + stream_header(2, "big", fmt="int64"), True),
        (HEAD + MORE, False),
        (HEAD + stream_header(2, "two") + footer(1, 0), False),
        ((HEAD + MORE + footer(1, 2))[:-5], False),
        (b"XDF:" + chunk(1, FILE_HEADER), False),
        (b"", False),
    ],
)
def test_a_recording_is_closed_once_all_its_streams_are(
    tmp_path: Path, content: bytes, is_closed: bool
) -> None:
    path = tmp_path / "a.xdf"
    path.write_bytes(content)
    seen = summarize(path)
    assert seen.is_closed is is_closed
    assert seen.bytes == len(content)
    still = wait_until_closed(path, 0.5, DEADLINE_S)
    assert still is not None
    assert still.is_closed is is_closed


@pytest.mark.nightly
def test_what_goes_on_growing_is_not_closed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a.xdf"
    path.write_bytes(HEAD)

    def grown(file: Path) -> int:
        with file.open("ab") as growing:
            growing.write(MORE)
        return file.stat().st_size

    # It grows from look to look, whoever is held up.
    monkeypatch.setattr(recording_file, "size_of", grown)
    begun = time.monotonic()
    assert wait_until_closed(path, 1.0, 3.0) is None
    assert time.monotonic() - begun >= 3.0
