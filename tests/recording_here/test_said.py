"""What is understood of the words of a program that records."""

from __future__ import annotations

from biosensor_gateway.recording.recorder.program import ProgramOutput


def test_the_last_words_have_no_letters_that_nobody_can_read() -> None:
    said = ProgramOutput(
        "Found a@pc matching 'x'\r\n\0\0\0\x07Started data collection for stream a.\r\n\0"
    )
    assert said.end == "Found a@pc matching 'x' / Started data collection for stream a."


def test_nothing_is_said_of_one_that_said_nothing() -> None:
    assert ProgramOutput("\0\0\r\n").end == "nothing"


def test_what_a_person_has_to_know_is_told_apart() -> None:
    said = ProgramOutput(
        "Found a@pc matching 'x'\nNote: a@pc has ended; 3 of its samples\r\na@pc goes on\n"
    )
    assert said.notes == ("a@pc has ended; 3 of its samples",)
