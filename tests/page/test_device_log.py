"""The end of the log of one device, whatever else is in the file."""

from __future__ import annotations

import json
import tempfile
from pathlib import Path

from hypothesis import given
from hypothesis import strategies as st

from biosensor_gateway.page.routes.devices import MOST_BYTES, MOST_LINES, last_lines
from biosensor_gateway.system.logs import LOG_FILE_NAME


def record(event: str, unit: str = "A", **facts: object) -> str:
    about = {"sensor": "zephyr", "unit": unit, "level": "warning"}
    when = {"timestamp": "2026-05-04T10:20:30.000000Z", "logger": "biosensor_gateway.agent"}
    return json.dumps({"event": event, **about, **when, **facts}) + "\n"


def sentences(folder: Path) -> list[str]:
    return [each.sentence for each in last_lines(folder, "zephyr", "A").lines]


def test_the_newest_of_the_device_come_first_with_their_facts(tmp_path: Path) -> None:
    log = tmp_path / LOG_FILE_NAME
    log.write_text(
        record("connected", firmware="1.2", reason="hidden")
        + record("connected", unit="B")
        + record("lost\x1b[31m", samples=3)
    )
    (line, _) = last_lines(tmp_path, "zephyr", "A").lines
    assert sentences(tmp_path) == ["lost\\x1b[31m (samples 3)", "connected (firmware 1.2)"]
    assert (line.level, line.time) == ("warning", "2026-05-04T10:20:30.000000Z")
    assert last_lines(tmp_path, "polar_h10", "A").lines == []


def test_a_file_that_has_just_been_filled_is_read_on(tmp_path: Path) -> None:
    (tmp_path / LOG_FILE_NAME).write_text(record("new"))
    (tmp_path / f"{LOG_FILE_NAME}.1").write_text(record("old"))
    assert sentences(tmp_path) == ["new", "old"]


def test_of_a_long_file_the_end_is_read(tmp_path: Path) -> None:
    assert sentences(tmp_path) == []
    lines = [record(f"event {each}") for each in range(5000)]
    (tmp_path / LOG_FILE_NAME).write_text("".join(lines))
    assert sum(map(len, lines)) > MOST_BYTES
    assert sentences(tmp_path) == [f"event {each}" for each in range(4999, 4999 - MOST_LINES, -1)]
    (tmp_path / LOG_FILE_NAME).write_text(record("x" * 100_000))
    assert len(sentences(tmp_path)[0]) < 500


@given(st.lists(st.binary(max_size=60) | st.sampled_from([b"[]", b"1", b'{"sensor": ["zephyr"]}'])))
def test_whatever_else_is_in_the_file_is_passed_over(noise: list[bytes]) -> None:
    with tempfile.TemporaryDirectory() as folder:
        content = b"\n".join([*noise, record("here").encode(), *noise])
        (Path(folder) / LOG_FILE_NAME).write_bytes(content)
        assert sentences(Path(folder)) == ["here"]
