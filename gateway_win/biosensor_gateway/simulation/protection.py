"""Protects what a virtual device tells paired hosts alone: characteristics and subscriptions."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Protocol, cast

from bumble import att
from bumble.gatt import (
    GATT_CLIENT_CHARACTERISTIC_CONFIGURATION_DESCRIPTOR as _SUBSCRIPTION,
)
from bumble.gatt import Characteristic, Service
from bumble.gatt_server import Server

_AUTHENTICATED = (
    att.Attribute.Permissions.READ_REQUIRES_AUTHENTICATION
    | att.Attribute.Permissions.WRITE_REQUIRES_AUTHENTICATION
)
Protected = tuple[Service, Characteristic[bytes]]
"""A characteristic that requires authentication, behind its service."""


class _Table(Protocol):
    """What is used of bumble's service, whose annotation leaves a type argument out."""

    characteristics: list[Characteristic[bytes]]


def protected_characteristics(services: Sequence[Service]) -> list[Protected]:
    """Return the characteristics that require authentication, with their services."""
    every = ((service, c) for service in services for c in cast("_Table", service).characteristics)
    return [(service, c) for service, c in every if c.permissions & _AUTHENTICATED]


def protect_subscriptions(server: Server, protected: Iterable[Protected]) -> None:
    """Ask of who subscribes to these characteristics what reading and writing them asks."""
    for service, characteristic in protected:
        # bumble makes the descriptor by itself, open to everybody.
        subscription = server.get_descriptor_attribute(
            service.uuid, characteristic.uuid, _SUBSCRIPTION
        )
        if subscription:
            subscription.permissions |= characteristic.permissions & _AUTHENTICATED
