"""``record start`` asks before it begins without a sensor that does not stream."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
import typer

from biosensor_gateway.cli import record
from biosensor_gateway.recording.recorder.request import RecordingRequest, SensorsAwayError

ORDER = RecordingRequest(Path("/data"))
AWAY = SensorsAwayError(["P03's strap is paused since 14:03"])


def _typed(answers: list[str]) -> Callable[[str], str]:
    def give(_question: str) -> str:
        return answers.pop()

    return give


@pytest.fixture
def answer(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """What a person at the terminal types, the last first."""
    typed: list[str] = []
    monkeypatch.setattr(record, "can_ask", lambda: True)
    monkeypatch.setattr("builtins.input", _typed(typed))
    return typed


def test_who_answers_yes_records_without_it(
    answer: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    answer.append("2")
    assert record.without_sensors(ORDER, AWAY).without_away
    assert "P03's strap is paused since 14:03." in capsys.readouterr().out


def test_enter_alone_records_nothing(answer: list[str]) -> None:
    answer.append("")
    with pytest.raises(typer.Exit) as ended:
        record.without_sensors(ORDER, AWAY)
    assert ended.value.exit_code == 2


def test_where_nobody_can_answer_it_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(record, "can_ask", lambda: False)
    with pytest.raises(SensorsAwayError):
        record.without_sensors(ORDER, AWAY)
