"""The headsets that Cortex services know."""

from __future__ import annotations

from collections.abc import Sequence
from urllib.parse import urlsplit

import structlog

from biosensor_gateway.devices.discovery import Found
from biosensor_gateway.devices.emotiv_insight.driver.account import Account, find_credentials
from biosensor_gateway.devices.emotiv_insight.driver.cortex import CortexClient, CortexError
from biosensor_gateway.devices.emotiv_insight.driver.failures import gateway_error
from biosensor_gateway.devices.emotiv_insight.driver.headsets import is_insight, search
from biosensor_gateway.devices.emotiv_insight.driver.results import Headset
from biosensor_gateway.devices.emotiv_insight.driver.settings import DEFAULT_URL, is_loopback
from biosensor_gateway.settings.models import DeviceSettings
from biosensor_gateway.transports.websocket import WebSocketLink

SEARCH_S = 10.0

_log = structlog.get_logger("biosensor_gateway.emotiv_insight")


async def find(configured: Sequence[DeviceSettings]) -> list[Found]:
    """Return the headsets that the services of the settings, or the usual one, have in reach.

    Raises
    ------
    CredentialError
        Client id or secret, login or approval are missing.
    TransportError
        ``ABSENT``: no Cortex service runs there.
    ProtocolError
        Cortex refuses or does not answer.
    """
    await find_credentials()
    services = {_service(each) for each in configured} or {(DEFAULT_URL, "")}
    found: list[Found] = []
    for url, ca_file in sorted(services):
        for each in await _headsets(url, ca_file):
            if is_insight(each):
                found.append(_found(url, ca_file, each))
            else:
                _log.warning("a headset is no Insight and cannot be used", headset=each.headset_id)
    return found


def _service(settings: DeviceSettings) -> tuple[str, str]:
    values = settings.model_dump()
    return values["url"], values["ca_file"]


async def _headsets(url: str, ca_file: str) -> list[Headset]:
    client = CortexClient(WebSocketLink(url, ca_file))
    try:
        await client.open()
        # Nobody waits in front of a search for somebody to log in.
        await Account().sign_in(client, patience_s=0.0)
        return await search(client, SEARCH_S, lambda _: False)
    except CortexError as error:
        raise gateway_error(error) from error
    finally:
        await client.close()


def _found(url: str, ca_file: str, headset: Headset) -> Found:
    settings: dict[str, str | int | float | bool] = {
        "unit": headset.headset_id,
        "headset": headset.headset_id,
    }
    if url != DEFAULT_URL:
        settings["url"] = url
        settings["allow_remote"] = not is_loopback(urlsplit(url).hostname or "")
    if ca_file:
        settings["ca_file"] = ca_file
    return Found("emotiv_insight", headset.name or headset.headset_id, settings)
