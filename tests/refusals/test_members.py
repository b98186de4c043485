"""Each refusal is provoked by real input, and shows above OK with its sentence."""

from __future__ import annotations

import re

import pytest

from biosensor_common.refusal import AGAIN_S, LATELY_S, Level, Refusal, Refusals
from tests.refusals import from_devices, from_streams, from_topics
from tests.refusals.provoked import PROVOKED

# Each registers what it provokes.
SOURCES = (from_devices, from_streams, from_topics)


def test_each_member_has_something_that_provokes_it() -> None:
    assert set(Refusal) - PROVOKED.keys() == set()


@pytest.mark.parametrize("what", Refusal, ids=lambda what: what.word)
def test_a_refusal_shows_above_ok_with_its_sentence(
    what: Refusal, monkeypatch: pytest.MonkeyPatch
) -> None:
    shown = PROVOKED[what](monkeypatch)
    assert shown.level == what.level
    # Facts stand where the sentence has a brace, with anything before and behind.
    parts = re.split(r"\{[^}]*\}", what.sentence)
    pattern = ".+".join(re.escape(part) for part in parts)
    assert re.search(pattern, shown.text), f"{shown.text!r} is not {what.sentence!r}"


def test_words_are_words_and_sentences_are_sentences() -> None:
    assert len({what.word for what in Refusal}) == len(Refusal)
    for what in Refusal:
        assert re.fullmatch(r"[a-z_]+", what.word)
        assert not what.sentence.endswith(".")
        assert what.level in (Level.WARN, Level.ERROR)


class Clock:
    now_s = 0.0

    def __call__(self) -> float:
        return self.now_s


def test_what_passes_is_shown_for_a_while_and_what_stands_until_it_is_over() -> None:
    clock, said = Clock(), list[str]()
    refusals = Refusals(said.append, "ecg", clock)
    refusals.refuse(Refusal.UNFIT, 2, why="it is too large")
    refusals.refuse(Refusal.NO_NUMBER)
    clock.now_s = LATELY_S + 1
    assert [each.what for each in refusals.present] == [Refusal.NO_NUMBER]
    refusals.refuse(Refusal.UNFIT, why="it is too large")
    assert refusals.count(Refusal.UNFIT) == 3
    assert len(said) == 2
    refusals.over(Refusal.NO_NUMBER)
    assert [each.sentence for each in refusals.present] == [
        "3 samples were not published: it is too large"
    ]
    clock.now_s = AGAIN_S + 1
    refusals.refuse(Refusal.UNFIT, why="it is too large")
    assert said[-1] == "ecg: 1 sample was not published: it is too large"
    assert (refusals.all[-1].first_s, refusals.all[-1].last_s) == (0.0, AGAIN_S + 1)


def test_the_worst_comes_first_and_a_report_of_long_ago_makes_room() -> None:
    refusals = Refusals()
    for number in range(1500):
        refusals.refuse(Refusal.UNUSABLE, about=str(number), why="it has no channels")
    refusals.refuse(Refusal.NO_TOPIC, about="/ecg", why="ROS refuses it", name="ecg")
    assert refusals.present[0].what is Refusal.NO_TOPIC
    assert len(refusals.all) == 1000
