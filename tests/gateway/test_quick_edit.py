"""QuickEdit is one flag among others, which must stay as they are."""

from __future__ import annotations

import sys

import pytest

from biosensor_gateway.system.windows_session import (
    ENABLE_EXTENDED_FLAGS,
    ENABLE_QUICK_EDIT_MODE,
    quick_edit_off,
    without_quick_edit,
)


# What a console of Windows 10 has, the same with Insert off, and one that has nothing.
@pytest.mark.parametrize(
    ("mode", "without"), [(0x01F7, 0x01B7), (0x01D7, 0x0197), (0x0000, 0x0080)]
)
def test_only_quick_edit_goes(mode: int, without: int) -> None:
    assert without_quick_edit(mode) == without
    changed = mode ^ without
    assert changed & ~(ENABLE_QUICK_EDIT_MODE | ENABLE_EXTENDED_FLAGS) == 0


@pytest.mark.skipif(sys.platform == "win32", reason="there it changes the console")
def test_other_systems_have_none() -> None:
    with quick_edit_off():
        pass
