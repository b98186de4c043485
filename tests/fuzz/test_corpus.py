"""Every input of every corpus keeps the contract; so regressions stay found."""

from __future__ import annotations

import pytest

from tests.fuzz.contract import CORPUS, NAMES, SENSORS, corpus_of, inputs, load, strictly

MAX_CORPUS_BYTES = 1_000_000


@pytest.mark.parametrize("name", NAMES)
def test_no_input_breaks_the_contract(name: str) -> None:
    target = load(name)
    broken: list[str] = []
    with strictly():
        for path in inputs(corpus_of(name)):
            try:
                target.check(path.read_bytes())
            except Exception as error:  # noqa: BLE001 - anything is a find
                broken.append(f"{path.name}: {type(error).__name__}: {error}")
    assert not broken, "\n".join(broken)


def test_every_target_has_a_corpus_and_no_corpus_is_left_over() -> None:
    tests = CORPUS.parents[1]
    own = {folder.name for folder in tests.glob("*/corpus/*") if folder.parent != CORPUS}
    assert own == set(SENSORS)
    assert {folder.name for folder in CORPUS.iterdir()} == set(NAMES) - own
    assert all(inputs(corpus_of(name)) for name in NAMES)


def test_the_corpora_are_small() -> None:
    sizes = [path.stat().st_size for name in NAMES for path in inputs(corpus_of(name))]
    assert sum(sizes) < MAX_CORPUS_BYTES
