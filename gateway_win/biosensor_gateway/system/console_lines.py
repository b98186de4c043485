"""Writes records of the log as lines for people: local time, the device, a sentence.

The file has everything; here is left out what only a program can use.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from datetime import datetime
from typing import cast

from structlog.typing import EventDict, WrappedLogger

from biosensor_common.terminal import wrapped

FOR_PEOPLE = "for_people"
"""Key of a record for the sentence that a terminal shows in place of the event and its facts."""

# Words of programs: the log file has them.
_UNSHOWN = frozenset({"code", "event_name", "reason", "where", "way"})
_EVERYWHERE = frozenset({"event", "level", "logger", "sensor", "text", "timestamp", "unit"})
_CONTROL = re.compile(r"[\x00-\x1f\x7f-\x9f]")
_MARKS = {"warning": "!", "error": "!", "critical": "!"}
_COLOURS = {"!": "\x1b[33m"}
_NORMAL = "\x1b[0m"
_HANG = len("hh:mm:ss ! ")


def without_line_for_people(
    _logger: WrappedLogger, _method: str, event_dict: EventDict
) -> EventDict:
    """Remove the sentence that only a terminal shows."""
    event_dict.pop(FOR_PEOPLE, None)
    return event_dict


def on_one_line(text: str) -> str:
    """Escape line ends and whatever would command a terminal."""
    return _CONTROL.sub(lambda found: repr(found[0])[1:-1], text)


class LinesForPeople:
    """The last processor of a terminal's records.

    Parameters
    ----------
    title
        Returns what people call a sensor.
    columns
        Returns how wide the terminal is; None where nothing needs to fit.
    colours
        Whether it shows any.
    verbose
        Show all facts.
    """

    def __init__(
        self,
        title: Callable[[str], str],
        columns: Callable[[], int | None],
        *,
        colours: bool,
        verbose: bool,
    ) -> None:
        self._title, self._columns = title, columns
        self._colours, self._verbose = colours, verbose

    def __call__(self, _logger: WrappedLogger, _method: str, event_dict: EventDict) -> str:
        """Return the line, without its end; wrapped between words."""
        mark = _MARKS.get(str(event_dict.get("level")), " ")
        text = on_one_line(f"{_clock_time(event_dict)} {mark} {self._sentence(event_dict)}")
        text = wrapped(text, self._columns(), _HANG)
        colour = _COLOURS.get(mark, "") if self._colours else ""
        return f"{colour}{text}{_NORMAL}" if colour else text

    def _sentence(self, record: EventDict) -> str:
        said = record.get(FOR_PEOPLE)
        if self._verbose or said is None:
            said = sentence_of(record, verbose=self._verbose)
        said = str(said)
        return f"{self._device(record, said)}{said}"

    def _device(self, record: EventDict, said: str) -> str:
        sensor, unit = str(record.get("sensor", "")), str(record.get("unit", ""))
        title = self._title(sensor) if sensor else ""
        # Many sentences begin with the device that they are about.
        name = "" if title and said.startswith(title) else f"{title} {unit}".strip()
        return f"{name}: " if name else ""


def sentence_of(record: Mapping[str, object], *, verbose: bool = False) -> str:
    """Say what happened, with its facts; the device and the time are left to others.

    Parameters
    ----------
    record
        Of the log, also as read from its file.
    verbose
        Show all facts.
    """
    # What a device's service says in a text of its own is the sentence.
    event = str(record.get("text") or record.get("event", ""))
    facts = ", ".join(_facts(record, verbose=verbose))
    return f"{event} ({facts})" if facts else event


def _facts(record: Mapping[str, object], *, verbose: bool) -> Iterator[str]:
    if verbose:
        known = _EVERYWHERE | {FOR_PEOPLE}
        yield from (f"{key}={value!r}" for key, value in record.items() if key not in known)
        return
    for key, value in record.items():
        if key in _EVERYWHERE or key in _UNSHOWN or value in (None, False, ""):
            continue
        words = key.replace("_", " ")
        yield words if value is True else f"{words} {_shown(value)}"


def _clock_time(record: Mapping[str, object]) -> str:
    try:
        moment = datetime.fromisoformat(str(record.get("timestamp"))).astimezone()
    except ValueError:
        moment = datetime.now().astimezone()
    return moment.strftime("%H:%M:%S")


def _shown(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, list | tuple | set | frozenset):
        return " ".join(str(each) for each in cast("list[object]", value))
    return str(value)
