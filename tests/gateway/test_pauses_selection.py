"""Which device is meant by a name."""

from __future__ import annotations

import pytest

from biosensor_common.errors import ConfigError
from biosensor_common.spec import DeviceIdentity
from biosensor_gateway.agent.selection import chosen

STRAP = DeviceIdentity("polar_h10", "A1", "p01", "left")
BELT = DeviceIdentity("zephyr", "B2", "p02")


@pytest.mark.parametrize("name", ["polar_h10/A1", "polar_h10", "left", "p01"])
def test_it_is_called_by_any_name_that_it_alone_has(name: str) -> None:
    assert chosen(name, [STRAP, BELT]) == STRAP


@pytest.mark.parametrize(
    ("name", "meant"),
    [("polar_h10/A2", "polar_h10/A1"), ("polarh10", "polar_h10"), ("lefft", "left")],
)
def test_a_misspelt_name_is_guessed(name: str, meant: str) -> None:
    with pytest.raises(ConfigError, match=rf"called '{name}' \(did you mean '{meant}'\?\); there"):
        chosen(name, [STRAP, BELT])
