"""What came early is kept in order up to a limit, and given out once."""

from __future__ import annotations

import pytest

from biosensor_gateway.transports.link import Early


def test_it_is_taken_once_and_in_order() -> None:
    early = Early[str](9)
    assert not early
    early.keep("a")
    early.keep("b", "c")
    assert early
    assert early.take() == ["a", "b", "c"]
    assert not early
    assert early.take() == []
    early.keep("d")
    assert early.take() == ["d"]


@pytest.mark.parametrize(("is_newest_kept", "kept"), [(False, [1, 2, 3]), (True, [3, 4, 5])])
@pytest.mark.parametrize("together", [True, False])
def test_there_is_room_for_so_many(is_newest_kept: bool, kept: list[int], together: bool) -> None:
    early = Early[int](3, is_newest_kept=is_newest_kept)
    for part in [(1, 2, 3, 4, 5)] if together else [(1, 2), (3, 4), (5,)]:
        early.keep(*part)
    assert early.take() == kept
    early.keep(6)
    assert early.take() == [6]
