"""Commands of the control channel that send, undo and list markers."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any, TypeGuard

import structlog

from biosensor_common.errors import ConfigError, ConfigReason
from biosensor_common.refusal import Refusal
from biosensor_gateway.agent.control_server import Command
from biosensor_gateway.settings.models import MarkerSettings
from biosensor_gateway.streaming.marker_stream import (
    Marker,
    MarkerKind,
    MarkerStream,
    TimedBy,
    Timing,
)

MAX_TEXT, MAX_SOURCE = 200, 32
MAX_WEB_SOURCE = 200
"""Longer for web experiments, whose source is the origin of their page."""
MAX_AGE_S, MAX_LEAD_S = 60.0, 0.1
"""How old a sender's time may be, and how far in the future because its clock is less exact."""
MAX_WEB_AGE_S = 3600.0
"""Longer for web experiments, which store their markers while they are offline."""
LISTED = 50
MARKERS = "markers"
"""The command that lists markers, and changes nothing."""

_log = structlog.get_logger("biosensor_gateway.markers")

_SENT = (MarkerKind.BUTTON, MarkerKind.NOTE, MarkerKind.API, MarkerKind.WEB)
_KINDS = {kind.value: kind for kind in _SENT}


class MarkerCommands:
    """Commands for markers.

    Parameters
    ----------
    settings
        Has the names of the buttons.
    """

    def __init__(self, stream: MarkerStream, settings: MarkerSettings) -> None:
        self._stream = stream
        self.settings = settings  # Can be replaced while the agent runs.

    @property
    def commands(self) -> dict[str, Command]:
        """The commands by name."""
        return {"mark": self._mark, "undo-marker": self._undo, MARKERS: self._list}

    async def _mark(self, arguments: Mapping[str, Any]) -> Mapping[str, Any]:
        """Send a marker.

        The arguments are ``marker``, ``note``, ``kind``, ``source`` and ``at``; for a web
        experiment also ``timed_by`` and ``uncertainty_s``.
        """
        marker, note = _text(arguments, "marker"), _text(arguments, "note")
        if not marker and not note:
            message = "the marker has no text; say what happened in 'marker' or 'note'"
            raise ConfigError(ConfigReason.WRONG_VALUE, message)
        kind = _kind(arguments, MarkerKind.API if marker else MarkerKind.NOTE)
        is_web = kind is MarkerKind.WEB
        sent = self._stream.mark(
            marker or MarkerKind.NOTE.value,
            note,
            kind,
            _text(arguments, "source", MAX_WEB_SOURCE if is_web else MAX_SOURCE),
            _time(arguments, MAX_WEB_AGE_S if is_web else MAX_AGE_S, self._stream.clock()),
            _timing(arguments) if is_web else None,
        )
        if not sent.received:
            people = Refusal.UNHEARD_MARKER.message()
            # nothing is dropped: the stream keeps it for a later receiver and has reported it
            _log.warning(
                "a marker was sent, but no program receives it", id=sent.id, for_people=people
            )
        answer = {"id": sent.id, "lsl_time": sent.lsl_time}
        return answer if sent.received else answer | {"received": False}

    async def _undo(self, arguments: Mapping[str, Any]) -> Mapping[str, Any]:
        """Undo the marker with the argument ``id``; without it, the last that is not undone."""
        number = arguments.get("id")
        if number is not None and (isinstance(number, bool) or not isinstance(number, int)):
            raise ConfigError(ConfigReason.WRONG_VALUE, "the argument 'id' is not an integer")
        own, of = self._stream.undo(number)
        return {"id": own, "of": of}

    async def _list(self, _arguments: Mapping[str, Any]) -> Mapping[str, Any]:
        """Return the last markers, the newest last, and the names of the buttons."""
        newest = [_as_json(each) for each in self._stream.newest(LISTED)]
        return {"markers": newest, "buttons": list(self.settings.buttons)}


def _as_json(marker: Marker) -> dict[str, Any]:
    timing = marker.timing
    # nothing is dropped: `timing` is added below
    content = {name: each for name, each in asdict(marker).items() if name != "timing"}
    return content | ({} if timing is None else timing._asdict())


def _text(arguments: Mapping[str, Any], name: str, longest: int = MAX_TEXT) -> str:
    given = arguments.get(name)
    if given is None:
        return ""
    if not isinstance(given, str):
        raise ConfigError(ConfigReason.WRONG_VALUE, f"the argument '{name}' is not text")
    text = given.strip()
    if len(text) > longest or not text.isprintable():
        message = (
            f"the argument '{name}' is not one line of printable text with at most {longest} "
            "characters"
        )
        raise ConfigError(ConfigReason.WRONG_VALUE, message)
    return text


def _kind(arguments: Mapping[str, Any], usual: MarkerKind) -> MarkerKind:
    given = arguments.get("kind")
    if given is None:
        return usual
    if not isinstance(given, str) or given not in _KINDS:
        message = f"the argument 'kind' must be one of {', '.join(_KINDS)}"
        raise ConfigError(ConfigReason.WRONG_VALUE, message)
    return _KINDS[given]


def _is_number(value: object) -> TypeGuard[float]:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _timing(arguments: Mapping[str, Any]) -> Timing:
    timed_by, uncertainty = arguments.get("timed_by"), arguments.get("uncertainty_s")
    if uncertainty is not None and not (_is_number(uncertainty) and 0 <= uncertainty < math.inf):
        message = "the argument 'uncertainty_s' is not a number of seconds"
        raise ConfigError(ConfigReason.WRONG_VALUE, message)
    if not isinstance(timed_by, str) or timed_by not in set(TimedBy):
        message = f"the argument 'timed_by' must be one of {', '.join(TimedBy)}"
        raise ConfigError(ConfigReason.WRONG_VALUE, message)
    return Timing(TimedBy(timed_by), None if uncertainty is None else round(uncertainty, 6))


def _time(arguments: Mapping[str, Any], oldest_s: float, now: float) -> float | None:
    at = arguments.get("at")
    if at is None:
        return None  # nothing is dropped: without a time it is now
    if not _is_number(at) or not now - oldest_s <= at <= now + MAX_LEAD_S:
        message = (
            f"the argument 'at' is not an LSL time from {oldest_s:g} s ago to {MAX_LEAD_S:g} s "
            f"ahead; now is {now:.3f}"
        )
        raise ConfigError(ConfigReason.WRONG_VALUE, message)
    return float(at)
