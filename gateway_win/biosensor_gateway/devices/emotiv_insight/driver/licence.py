"""Asks Cortex what the user's Emotiv licence does not cover."""

from __future__ import annotations

from collections.abc import Sequence

from biosensor_gateway.devices.driver import own_settings
from biosensor_gateway.devices.emotiv_insight.driver import results
from biosensor_gateway.devices.emotiv_insight.driver.account import Account
from biosensor_gateway.devices.emotiv_insight.driver.cortex import CortexClient, CortexError
from biosensor_gateway.devices.emotiv_insight.driver.failures import gateway_error
from biosensor_gateway.devices.emotiv_insight.driver.settings import EmotivInsightSettings
from biosensor_gateway.settings.models import DeviceSettings
from biosensor_gateway.transports.websocket import WebSocketLink

EXPIRED = "it has expired"
NO_RAW_EEG = "it does not cover raw EEG: eeg and eeg_status stay empty"
SLOW_METRICS = "it does not cover performance metrics: met comes every 10 s, not twice a second"


async def unlicensed(settings: DeviceSettings) -> Sequence[str]:
    """Sign in, without drawing sessions from a counted licence, and ask.

    Raises
    ------
    CredentialError
        ``MISSING``: a client id or secret, a user, an approval; ``REJECTED``.
    ProtocolError, TransportError
        See :meth:`CortexClient.call`.
    """
    own = own_settings(EmotivInsightSettings, settings)
    client = CortexClient(WebSocketLink(own.url, own.ca_file))
    account = Account(own.license)
    try:
        await client.open()
        await account.sign_in(client, patience_s=0.0)
        licence = results.licence(await account.call(client, "getLicenseInfo", {}))
    except CortexError as error:
        raise gateway_error(error) from error
    finally:
        await client.close()
    found = [EXPIRED] if licence.expired else []
    found += [NO_RAW_EEG] if "eeg" not in licence.scopes else []
    return found + ([SLOW_METRICS] if "pm" not in licence.scopes else [])
