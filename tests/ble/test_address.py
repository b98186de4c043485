"""A device whose name is not heard is taken by its address."""

from __future__ import annotations

from biosensor_gateway.transports.ble_choice import Choice
from biosensor_gateway.transports.nearby import Advertisement

ADDRESS = "00:55:DA:B0:3A:1F"


def by_name(seen: Advertisement) -> str | None:
    """Tell a kind as drivers do whose devices say it in their name alone."""
    return seen.name.removeprefix("Kind ") if seen.name.startswith("Kind ") else None


def test_the_address_alone_is_enough() -> None:
    choice = Choice(by_name, "Kind", ADDRESS.lower())
    assert choice.claims(Advertisement(ADDRESS), from_generic=False)
    assert not choice.claims(Advertisement("00:55:DA:B0:3A:20"), from_generic=False)
    assert not Choice(by_name, "Kind", "3A1F").claims(Advertisement(ADDRESS), from_generic=False)
