"""The wristbands of E4 servers."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from biosensor_gateway.devices.discovery import Found
from biosensor_gateway.devices.empatica_e4.driver.conversation import Conversation
from biosensor_gateway.devices.empatica_e4.driver.messages import Wristband
from biosensor_gateway.settings.models import DeviceSettings

DEFAULT_HOST, DEFAULT_PORT = "127.0.0.1", 28000
_TIMEOUT_S = 3.0


async def find(configured: Sequence[DeviceSettings]) -> list[Found]:
    """Ask the servers of the settings, or the usual one, for their wristbands.

    Raises
    ------
    TransportError, ProtocolError
        A server does not answer.
    """
    servers = {_server(settings) for settings in configured} or {(DEFAULT_HOST, DEFAULT_PORT)}
    found: list[Found] = []
    for host, port in sorted(servers):
        found += [_found(host, port, each) for each in await _wristbands(host, port)]
    return found


def _server(settings: DeviceSettings) -> tuple[str, int]:
    values = settings.model_dump()
    return values["host"], values["port"]


async def _wristbands(host: str, port: int) -> Iterable[Wristband]:
    """Those that the server streams, and those that it could."""
    talk = Conversation(host, port)
    try:
        await talk.open()
        known = [
            await talk.ask(command, timeout_s=_TIMEOUT_S)
            for command in ("device_list", "device_discover_list")
        ]
    finally:
        await talk.close()
    return {each.device: each for reply in known for each in reply.devices}.values()


def _found(host: str, port: int, wristband: Wristband) -> Found:
    settings: dict[str, str | int | float | bool] = {
        "unit": wristband.device.upper(),
        "device": wristband.device,
    }
    if (host, port) != (DEFAULT_HOST, DEFAULT_PORT):
        settings |= {"host": host, "port": port}
    return Found("empatica_e4", f"E4 {wristband.device}", settings)
