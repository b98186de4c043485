"""Captures a device: runs its driver for a while, and records the events on its links."""

from __future__ import annotations

import json
import platform
import re
import sys
import time
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from typing import Any, Literal, NamedTuple, cast, get_args, get_origin

from biosensor_common.errors import ConfigError, ConfigReason, CredentialError
from biosensor_common.spec import DeviceInfo
from biosensor_gateway.captures.file import Advertised, Capture, Event, Header, Row
from biosensor_gateway.captures.redaction import Redaction, Replaced, is_address, is_searched
from biosensor_gateway.devices.registry import declaration, declaration_names, driver
from biosensor_gateway.doctor.device_test import DeviceTest, run_device_test
from biosensor_gateway.settings.models import DeviceSettings
from biosensor_gateway.settings.secrets import SecretName, find_secret
from biosensor_gateway.transports.nearby import Advertisement
from biosensor_gateway.transports.tap import Characteristic, Passed, Tap, What, tapped

_OF_THE_LAB = frozenset(DeviceSettings.model_fields)
_WORD = re.compile(r"[^\W\d_]+")
_USUAL = ("time", "count", "number", "left", "right", "value", "heart", "rate", "skin", "channel")


def events_of(tap: Tap) -> list[Event]:
    """Return all events in the order of their times."""
    if not tap.links:
        return []  # nothing is dropped: nothing was opened
    times = [*(each[0] for each in tap.links), *(each.begun_s for _, each in tap.events)]
    begin_s = min(times)
    events: list[Event] = []
    for number, (opened_s, seen, table) in enumerate(tap.links):
        # nothing is dropped: each event belongs to one link
        own = [each for link, each in tap.events if link == number]
        # A thread may read data before the event loop is notified of the link.
        first_s = min([opened_s, *(each.begun_s for each in own)])
        events.append(_opening(number, first_s - begin_s, seen, table))
        events += [_event(number, each, begin_s) for each in own]
    return sorted(events, key=lambda each: each.t)


def _opening(
    link: int, t: float, seen: Advertisement | None, table: Sequence[Characteristic]
) -> Event:
    advertised = None
    if seen is not None:
        data = {company: each.hex() for company, each in seen.manufacturer_data.items()}
        advertised = Advertised(
            address=seen.address,
            name=seen.name,
            rssi_dbm=seen.rssi_dbm,
            services=tuple(sorted(seen.service_uuids)),
            manufacturer=data,
        )
    rows = tuple(
        Row(
            uuid=row.uuid.lower(),
            service=row.service_uuid.lower(),
            properties=tuple(row.properties),
        )
        for row in table
    )
    return Event(t=round(t, 6), link=link, what=What.OPENED, seen=advertised, table=rows)


def _event(link: int, passed: Passed, begin_s: float) -> Event:
    return Event(
        t=round(passed.begun_s - begin_s, 6),
        link=link,
        what=passed.what,
        at=passed.at.lower(),
        data=passed.data.hex(),
        took=round(max(0.0, passed.ended_s - passed.begun_s), 6),
        error=passed.error,
    )


class Taken(NamedTuple):
    """A capture before consent."""

    capture: Capture
    replaced: list[Replaced]  # What was replaced in it.
    test: DeviceTest  # Outcome of the driver's test of the device.


async def take(settings: DeviceSettings, seconds: float, tap: Tap | None = None) -> Taken:
    """Connect to a device and capture it for *seconds*.

    Parameters
    ----------
    tap
        A new tap, for callers that show the progress.

    Raises
    ------
    ConfigError
        ``WRONG_VALUE`` if the device has no link that can be captured.
    TransportError, ProtocolError
        As for :func:`~biosensor_gateway.doctor.device_test.run_device_test`.
    """
    tap = tap or Tap()
    with tapped(tap):
        test = await run_device_test(settings, seconds, tap.end)
    return taken(tap, settings, test)


def taken(tap: Tap, settings: DeviceSettings, test: DeviceTest) -> Taken:
    """Make a capture of recorded events, without what identifies the owner of the device.

    Raises
    ------
    ConfigError
        ``WRONG_VALUE`` if there are no events, or something that was to be replaced is left.
    """
    events = events_of(tap)
    if not events:
        raise ConfigError(ConfigReason.WRONG_VALUE, _nothing(tap, settings, test))
    entry, info = driver(settings.sensor), test.info or DeviceInfo()
    recognise = entry.recognise
    redaction = Redaction(
        (lambda seen: recognise(seen) is not None) if recognise is not None else lambda _: False,
        entry.identifiers,
    )
    secrets = [*filter(None, map(_known, entry.secrets))]
    kept, left_out = _own_settings(settings, entry.forms)
    known = [info.serial_number, *_addresses(settings)]
    redacted = redaction.of(events, known, secrets, _own_words(kept))
    kept = json.loads(redaction.text(json.dumps(kept, ensure_ascii=False)))
    header = Header(
        sensor=settings.sensor,
        manufacturer=redaction.text(info.manufacturer),
        model=redaction.text(info.model),
        firmware=redaction.text(info.firmware_version),
        settings=kept,
        left_out=left_out,
        system=_system(),
        radio=_radio(),
        gateway=version("biosensor-gateway"),
        recorded=time.strftime("%Y-%m"),
        seconds=round(max(each.t + each.took for each in redacted), 1),
        failed=dict(tap.failed),
    )
    capture = Capture(header=header, events=tuple(redacted))
    if left := redaction.left_in(redacted, _texts(header)):
        # A safeguard: this would be a defect of the redaction, and the file must not be shown.
        kinds = ", ".join(sorted({each.kind for each in left}))
        message = (
            "nothing could be captured: data that identifies the device would remain in it "
            f"({kinds})"
        )
        raise ConfigError(ConfigReason.WRONG_VALUE, message)
    return Taken(capture, redaction.replaced, test)


def _texts(header: Header) -> str:
    """Return the texts of a header that come from the device or the settings."""
    own = (header.manufacturer, header.model, header.firmware, json.dumps(header.settings))
    return "\n".join(own)


def _known(name: SecretName) -> str:
    """Return a secret that the driver may have used; empty if it is not stored."""
    try:
        return find_secret(name).reveal()
    except CredentialError:
        return ""


def _nothing(tap: Tap, settings: DeviceSettings, test: DeviceTest) -> str:
    if tap.failed or test.info is None:
        why = "; ".join(test.problems) or "the device did not connect"
        return f"nothing could be captured: {why}"
    if driver(settings.sensor).recognise is not None:
        return (
            f"{settings.sensor} is received without a connection, so there is nothing to "
            "capture; send a recording instead"
        )
    return (
        f"{settings.sensor} is reached through another program's library, which gives values and "
        "not the device's bytes, so there is nothing to capture; send a recording instead"
    )


def _addresses(settings: DeviceSettings) -> list[str]:
    """Return the settings that are addresses, as the port is for Bluetooth Classic."""
    texts = [each for each in dict(settings).values() if isinstance(each, str)]
    return [each for each in texts if is_address(each)]


def _own_settings(
    settings: DeviceSettings, forms: frozenset[str]
) -> tuple[dict[str, Any], tuple[str, ...]]:
    """Return settings that are numbers, lists, choices or forms, and the names of the others.

    The others are free texts, which may identify the owner or the place.
    """
    kept: dict[str, Any] = {}
    left_out: list[str] = []
    for name, field in type(settings).model_fields.items():
        value = getattr(settings, name)
        if name in _OF_THE_LAB or value == field.default:
            continue  # nothing is dropped: it is as by default
        is_choice = get_origin(field.annotation) is Literal and value in get_args(field.annotation)
        is_plain = isinstance(value, bool | int | float | tuple) and name != "port"
        if is_choice or is_plain or name in forms:
            kept[name] = value
        else:
            left_out.append(name)
    return kept, tuple(left_out)


def _own_words(kept: Mapping[str, Any]) -> list[str]:
    """Return the words in lists of the settings, such as columns, that no declaration has."""
    lists = (cast("tuple[object, ...]", e) for e in kept.values() if isinstance(e, tuple))
    words = {word for each in lists for text in each for word in _WORD.findall(str(text))}
    usual = set(_USUAL)
    for name in declaration_names():
        for stream in declaration(name).streams:
            told = (stream.data_name, stream.content_type, *(e.label for e in stream.channels))
            units = (each.unit for each in stream.channels)
            usual |= {word.lower() for each in (*told, *units) for word in _WORD.findall(each)}
    return sorted(each for each in words if is_searched(each) and each.lower() not in usual)


def _system() -> str:
    """Return system, version and processor, without the name of the computer."""
    return f"{platform.system()} {platform.release()} ({platform.version()}), {platform.machine()}"


def _radio() -> str:
    """Return the Bluetooth stack, as far as it is known without administrator rights."""
    stacks = {"win32": "WinRT", "darwin": "CoreBluetooth", "linux": "BlueZ"}
    return f"{stacks.get(sys.platform, sys.platform)}, bleak {version('bleak')}"
