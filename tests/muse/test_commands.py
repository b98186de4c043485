"""Commands, and answers in pieces."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from biosensor_gateway.devices.muse.driver.protocol import (
    Answer,
    Answers,
    battery_percent,
    encode,
    return_code,
    text_of,
)
from tests.muse.known import bytes_named, bytes_of, of_kind

PIECE_BYTES = 20
REAL = Path(__file__).parent / "vectors" / "real_control_pieces.json"
ANSWERS = st.lists(
    st.dictionaries(
        st.sampled_from(["rc", "sn", "fw"]), st.integers() | st.text("a b-{", max_size=9)
    ),
    max_size=5,
)


def counted(text: str) -> bytes:
    """Return a piece as it is sent."""
    return (bytes((len(text),)) + text.encode("ascii")).ljust(PIECE_BYTES, b"\0")


def all_of(answers: Answers, piece: bytes) -> list[Answer]:
    """Return all answers that a piece ends."""
    first = answers.feed(piece)
    return [] if first is None else [first, *answers.complete]


def fed(answers: Answers, data: bytes) -> list[Answer]:
    pieces = [data[at : at + PIECE_BYTES] for at in range(0, len(data), PIECE_BYTES)]
    return [found for each in pieces if (found := answers.feed(each)) is not None]


@of_kind("command")
def test_a_command_is_counted_text(vector: dict[str, Any]) -> None:
    assert encode(vector["expected"]) == bytes_of(vector)


@pytest.mark.parametrize("text", ["", "p" * 19, "µ"])
def test_what_is_no_command_is_not_sent(text: str) -> None:
    with pytest.raises(ValueError, match=r"not a command|ascii"):
        encode(text)


@of_kind("answer")
def test_pieces_make_an_answer(vector: dict[str, Any]) -> None:
    expected = vector["expected"]
    assert fed(Answers(), bytes_of(vector)) == ([] if expected is None else [expected])


def test_what_is_left_of_a_cut_answer_does_not_spoil_the_next_one() -> None:
    status = bytes_named("status")
    answers = Answers()
    assert fed(answers, status[:-PIECE_BYTES]) == []
    assert [return_code(each) for each in fed(answers, bytes_named("refusal"))] == [69]
    assert len(fed(answers, status)) == 1


@pytest.mark.parametrize(
    ("told", "percent"),
    [("58.27", 58.27), ("100", 100.0), ("101", None), ("true", None), ('"9"', None), ("-1", None)],
)
def test_a_battery_level_is_a_percentage_or_unknown(told: str, percent: float | None) -> None:
    assert battery_percent(json.loads(f'{{"bp":{told}}}')) == percent
    assert battery_percent({}) is None


def test_texts_are_printable_and_codes_are_numbers() -> None:
    assert text_of({"sn": "40\x0721"}, "sn") == "4021"
    assert text_of({}, "sn") == ""
    assert return_code({"rc": "no"}) != 0
    assert return_code({}) == 0


@given(st.lists(st.binary(max_size=24), max_size=8))
def test_any_pieces_are_an_answer_or_none(pieces: list[bytes]) -> None:
    answers = Answers()
    for piece in pieces:
        found = answers.feed(piece)
        assert found is None or isinstance(found, dict)


def test_an_answer_that_ends_where_the_next_one_begins_is_read() -> None:
    real = json.loads(REAL.read_text("utf-8"))
    answers = Answers()
    found = [each for text in real["pieces"] for each in all_of(answers, counted(text))]
    assert found == real["expected"]


@given(ANSWERS, st.data())
def test_answers_may_be_cut_anywhere(sent: list[Answer], data: st.DataObject) -> None:
    text = "".join(json.dumps(each, separators=(",", ":")) for each in sent)
    answers = Answers()
    found: list[Answer] = []
    while text:
        room = data.draw(st.integers(1, PIECE_BYTES - 1))
        found += all_of(answers, counted(text[:room]))
        text = text[room:]
    assert found == sent
