"""Fuzzing without coverage, where atheris does not run: mutations drawn by hypothesis.

Its strength is the end of the work: a find is shrunk to the shortest mutation of the
corpus that still breaks the contract.
"""

from __future__ import annotations

import hashlib
import sys
import time
import traceback
from collections.abc import Sequence
from pathlib import Path

from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis import strategies as st

from tests.fuzz.contract import Target, inputs, telling, tokens

Edit = tuple[int, int, bytes]
"""Where, how many bytes are replaced, by what."""
RUNNING = "running"
"""The input that is being tried; what is left of it when a process hangs or dies."""

_BATCH = 25
_MOST_EDITS = 6
_TOGETHER = 20
_ACCEPTED = (
    HealthCheck.data_too_large,
    HealthCheck.filter_too_much,
    HealthCheck.large_base_example,
    HealthCheck.too_slow,
)
_MAX_BYTES = 4096
_LENGTHS = (0, 1, 1, 2, 4, 8, 64, _MAX_BYTES)
_TOKENS = tokens()
_ODD_BYTES = (0x00, 0x01, 0x02, 0x0A, 0x20, 0x7F, 0x80, 0xFE, 0xFF)


def fuzz(target: Target, finds: Path, corpora: Sequence[Path], until: float, first: int = 0) -> int:
    """Try the corpora, then mutations of them; return 1 with the first find, else 0.

    Parameters
    ----------
    until
        Unix time; one batch is tried in any case.
    first
        Seed of the first batch; 0 for another one in each run.
    """
    known = [path.read_bytes() for folder in corpora for path in inputs(folder)]
    tried = _Tried(target, finds / RUNNING)
    try:
        for data in known:
            tried(data)
        number = begun = first or time.time_ns()
        while number == begun or time.time() < until:
            _try_batch(tried, known, number)
            number += 1
    except Exception:  # noqa: BLE001 - whatever a target raises is what is looked for
        digest = hashlib.sha1(tried.last, usedforsecurity=False).hexdigest()
        (finds / f"crash-{digest}").write_bytes(tried.last)
        traceback.print_exc()
        return 1
    finally:
        (finds / RUNNING).unlink(missing_ok=True)
        sys.stderr.write(f"stat::number_of_executed_units: {tried.count}\n")
    return 0


class _Tried:
    """Runs a target, and remembers with what."""

    def __init__(self, target: Target, note: Path) -> None:
        self._check, self._note = telling(target.check), note
        self.last = b""
        self.count = 0

    def __call__(self, data: bytes) -> None:
        self.last = data
        self.count += 1
        self._note.write_bytes(data)
        self._check(data)


def _try_batch(tried: _Tried, known: Sequence[bytes], number: int) -> None:
    @seed(number)
    @settings(
        max_examples=_BATCH,
        database=None,
        deadline=None,
        phases=(Phase.generate, Phase.shrink),
        suppress_health_check=_ACCEPTED,
        print_blob=False,
    )
    @given(st.integers(0, len(known)), _edits(known))
    def attempt(first: int, edits: list[Edit]) -> None:
        # Drawing takes longer than most targets, so what was drawn is used for many.
        for data in [b"", *known][first : first + _TOGETHER]:
            tried(_edited(data, edits))

    attempt()


def _edits(known: Sequence[bytes]) -> st.SearchStrategy[list[Edit]]:
    pieces = _pieces(st.sampled_from([b"", *known]))
    edits = st.tuples(st.integers(0, _MAX_BYTES), st.sampled_from(_LENGTHS), pieces)
    return st.lists(edits, min_size=1, max_size=_MOST_EDITS)


def _edited(data: bytes, edits: Sequence[Edit]) -> bytes:
    for place, length, piece in edits:
        start = place % (len(data) + 1)
        data = data[:start] + piece + data[start + length :]
    return data[:_MAX_BYTES]


def _pieces(sources: st.SearchStrategy[bytes]) -> st.SearchStrategy[bytes]:
    """Nothing, odd or any bytes, words, digits, or a part of an input."""
    parts = st.tuples(sources, st.integers(0, _MAX_BYTES), st.integers(1, 64))
    return st.one_of(
        st.just(b""),
        st.sampled_from(_ODD_BYTES).map(lambda byte: bytes((byte,))),
        st.binary(max_size=8),
        st.sampled_from(_TOKENS),
        st.text("0123456789.-+e", max_size=6).map(str.encode),
        parts.map(_part),
    )


def _part(choice: tuple[bytes, int, int]) -> bytes:
    data, place, length = choice
    start = place % (len(data) + 1)
    return data[start : start + length]
