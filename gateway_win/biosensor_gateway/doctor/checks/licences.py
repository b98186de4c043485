"""Checks what the vendors' licences cover."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from biosensor_common.doctor.finding import Finding, error, note, ok, warning
from biosensor_common.errors import CredentialError, GatewayError
from biosensor_gateway.devices.registry import declaration
from biosensor_gateway.doctor.context import Context
from biosensor_gateway.settings.models import DeviceSettings

if TYPE_CHECKING:
    from biosensor_gateway.devices.driver import DriverEntry
    from biosensor_gateway.settings.secrets import SecretName

ANSWER_S = 10.0


def examine(context: Context) -> Iterator[Finding]:
    """Sign in to each service whose streams need a licence, and ask what it does not cover."""
    if not context.enabled:
        return
    from biosensor_gateway.devices.registry import driver  # brings all drivers' libraries

    asked: set[str] = set()
    for device in context.enabled:
        entry = driver(device.sensor)
        # One licence serves all devices of a service.
        if entry.unlicensed is None or device.sensor in asked or not _are_there(entry.secrets):
            continue
        asked.add(device.sensor)
        yield from _licence(entry, device)


def _licence(entry: DriverEntry, device: DeviceSettings) -> Iterator[Finding]:
    title = declaration(device.sensor).title
    try:
        clauses = asyncio.run(_unlicensed(entry, device))
    except CredentialError as problem:
        yield error(
            f"{title}: {problem}",
            "The agent goes on trying, and streams nothing of this device until it may.",
            "do what the sentence says, in the vendor's program",
        )
    except (GatewayError, TimeoutError) as problem:
        yield note(
            f"{title}: its licence could not be looked at ({problem or 'no answer'})",
            "Streams that it does not cover stay empty.",
            "look at the check services first: biosensor-gateway doctor --only services",
        )
    else:
        for clause in clauses:
            yield warning(
                f"{title}: the licence: {clause}",
                "A recording has such a stream, and too little or nothing in it.",
                "extend the licence in your account with the vendor, or do without; wait-ready "
                "then needs its option --without",
            )
        if not clauses:
            yield ok(f"{title}: the licence covers all streams")


async def _unlicensed(entry: DriverEntry, device: DeviceSettings) -> Sequence[str]:
    if entry.unlicensed is None:
        return ()
    async with asyncio.timeout(ANSWER_S):
        return await entry.unlicensed(device)


def _are_there(secrets: Sequence[SecretName]) -> bool:
    """Whether all secrets can be found; the check of the services says which cannot."""
    from biosensor_gateway.settings.secrets import find_secret  # slow to import

    try:
        for secret in secrets:
            find_secret(secret)
    except CredentialError:
        return False
    return True
