"""A capture before consent: its contents are shown, then it is saved or discarded.

The command line makes one with :func:`~biosensor_gateway.captures.recorder.take`. A page has a
:class:`CaptureDesk`: it calls ``start`` and shows ``progress``. Once that is ``READY``, it shows
``draft.lines``, ``draft.problems`` and `CONSENT`, and ``draft.whole`` on request. Then it calls
``save`` or ``discard``. Nothing is written before, and nothing is ever sent.
"""

from __future__ import annotations

import asyncio
import json
import re
from collections.abc import Iterator
from contextlib import suppress
from enum import StrEnum
from pathlib import Path
from secrets import token_hex
from typing import NamedTuple

from biosensor_common.errors import ConfigError, ConfigReason, GatewayError
from biosensor_gateway.captures.file import ENDING, Capture, packed
from biosensor_gateway.captures.recorder import Taken, take
from biosensor_gateway.captures.redaction import LEAST_SEARCHED, is_searched
from biosensor_gateway.settings.models import DeviceSettings
from biosensor_gateway.system.clock import LSL_CLOCK, Clock
from biosensor_gateway.transports.tap import Tap

SECONDS = 60.0
"""Default length of a capture."""
CONSENT = (
    "An electrocardiogram, a pulse wave, an EEG and the way a person moves can identify that "
    "person without a name, as a fingerprint can. The file will be public, for everyone and "
    "permanently: under the licence CC0-1.0, which gives up all rights, nobody can take it back. "
    "So send it only if you wore the device, or if the wearer knows all this and agrees; for a "
    "child, the parents."
)
AGREED = "The wearer of the device agrees that it is public under CC0-1.0."
HOW_TO_SEND = 'To send it, open an issue of the kind "A capture of a device" and attach the file.'
MOST_NOTE = 300
"""Longest note, in characters."""
_SHOWN_BYTES = 24
_SHOWN_CHARACTERS = 40
_UNFIT = re.compile(r"[^A-Za-z0-9.]+")


class Draft:
    """A capture before consent.

    Parameters
    ----------
    source
        Source of the bytes, if not a real device.
    """

    def __init__(self, taken: Taken, source: str = "") -> None:
        self._taken, self._source = taken, source

    @property
    def problems(self) -> list[str]:
        """Problems of the device that the driver found, one sentence each."""
        return self._taken.test.problems

    @property
    def lines(self) -> list[str]:
        """Summary of the file and of what was replaced in it; some lines are indented."""
        return [*_contents(self._taken.capture), *_replaced(self._taken)]

    def whole(self) -> Iterator[str]:
        """Yield each line of the file as it would be saved, as JSON."""
        yield self._taken.capture.header.model_dump_json()
        for event in self._taken.capture.events:
            yield event.model_dump_json(exclude_defaults=True)

    def save(self, path: Path, note: str = "") -> Path:
        """Write the file with the consent in it; to be called only after consent.

        Parameters
        ----------
        path
            A new file, or an existing folder.
        note
            Observations, without names; cut after `MOST_NOTE`. What was replaced in the data is
            replaced here, too.

        Raises
        ------
        ConfigError
            As `refuse_place`; ``UNREADABLE`` if it cannot be written.
        """
        for each in self._taken.replaced:
            if is_searched(each.secret):
                parts = re.split(re.escape(each.secret), note, flags=re.IGNORECASE)
                note = each.pseudonym.join(parts)
        update = {"consent": AGREED, "note": note[:MOST_NOTE], "source": self._source}
        capture = self._taken.capture
        header = capture.header.model_copy(update=update)
        content = packed(capture.model_copy(update={"header": header}))
        file = path / file_name(capture) if path.is_dir() else path
        refuse_place(file)
        try:
            with file.open("xb") as opened:
                opened.write(content)
        except FileExistsError as error:  # nothing is dropped: the draft is kept
            raise _taken_name(file) from error
        except OSError as error:
            # Half of a capture is none, and its name would be taken.
            # nothing is dropped: the draft is kept
            with suppress(OSError):
                file.unlink()
            message = f"{file} cannot be written ({error.strerror}); choose another place"
            raise ConfigError(ConfigReason.UNREADABLE, message) from error
        return file.resolve()


def refuse_place(path: Path) -> None:
    """Refuse a place at which no capture can be saved, before anybody has worn the device for it.

    Raises
    ------
    ConfigError
        ``EXISTS`` if it is a file; ``NOT_FOUND`` if its folder does not exist.
    """
    if path.is_dir():
        return  # nothing is dropped: it gets a new name there
    if path.exists():
        raise _taken_name(path)
    if not path.parent.is_dir():
        message = f"there is no folder {path.parent}; make it, or choose another place"
        raise ConfigError(ConfigReason.NOT_FOUND, message)


def _taken_name(path: Path) -> ConfigError:
    return ConfigError(ConfigReason.EXISTS, f"{path} already exists; choose another name")


def file_name(capture: Capture) -> str:
    """Return a file name with the kind of device, and nothing about its owner."""
    header = capture.header
    parts = (header.sensor, header.model, header.firmware, token_hex(2))
    return "-".join(_UNFIT.sub("_", each) for each in parts if each) + ENDING


def _contents(capture: Capture) -> Iterator[str]:
    header = capture.header
    yield "The file contains:"
    known = (header.manufacturer, header.model, header.firmware)
    yield f"  device: {header.sensor}, {', '.join(filter(None, known)) or 'nothing known about it'}"
    yield f"  computer: {header.system}; {header.radio}; biosensor-gateway {header.gateway}"
    yield f"  month: {header.recorded}; length: {header.seconds:g} s"
    if header.settings:
        yield f"  settings: {json.dumps(header.settings)}"
    if header.left_out:
        yield f"  left out of the settings: {', '.join(header.left_out)}"
    seen = capture.events[0].seen
    if seen is not None:
        yield f"  advertised: {seen.name or 'no name'}, {seen.address}"
    yield "  data exchanged, with its times and first bytes:"
    groups: dict[tuple[str, str], list[bytes]] = {}
    for event in capture.events:
        groups.setdefault((event.what.value, event.at), []).append(event.bytes)
    for (what, at), packets in groups.items():
        size = sum(map(len, packets))
        # nothing is dropped: a draft shows the first bytes of each kind
        first = _first_bytes(next(filter(None, packets), b""))
        yield f"    {what} {at}".rstrip() + f": {len(packets)} times, {size} bytes; {first}"
    yield "The device's own clock is included unchanged, and may reveal date and time."


def _first_bytes(packet: bytes) -> str:
    shown = packet[:_SHOWN_BYTES]
    text = shown.decode("ascii", "replace").rstrip("\r\n")
    return text if text.isascii() and text.isprintable() else shown.hex(" ")


def _replaced(taken: Taken) -> Iterator[str]:
    yield "Replaced:" if taken.replaced else "There was nothing to replace."
    for each in taken.replaced:
        found = f", {each.times} times in the data" if each.times else ""
        if each.kind == "secret":
            yield f"    a secret of {len(each.secret)} characters{found}"
        else:
            yield f"    {each.kind}: {_short(each.secret)} became {_short(each.pseudonym)}{found}"
    if not all(is_searched(each.secret) for each in taken.replaced):
        yield (
            f"The file was searched for those of {LEAST_SEARCHED} or more bytes: none is "
            "left. Shorter ones were replaced only where the device says what they are."
        )
    elif taken.replaced:
        yield "The file was searched for each of them: none is left."


def _short(text: str) -> str:
    return text if len(text) <= _SHOWN_CHARACTERS else f"{text[:_SHOWN_CHARACTERS]}..."


class Phase(StrEnum):
    """Phases of a capture."""

    NONE = "none"
    CONNECTING = "connecting"
    CAPTURING = "capturing"
    READY = "ready"
    FAILED = "failed"


class Progress(NamedTuple):
    """Progress of a capture."""

    phase: Phase = Phase.NONE
    sensor: str = ""  # Name of the sensor; empty without a capture.
    # elapsed_s, seconds: time since the device was connected, and total time from then on.
    elapsed_s: float = 0.0
    seconds: float = 0.0
    packets: int = 0
    problem: str = ""  # Why the capture failed: a sentence.


class CaptureDesk:
    """Runs one capture at a time, in the background of an event loop.

    The caller has to ensure that the agent is not connected to the device.
    """

    def __init__(self, clock: Clock = LSL_CLOCK) -> None:
        self._clock = clock
        self._task: asyncio.Task[None] | None = None
        self._tap = Tap()
        self._begun = Progress()
        self.draft: Draft | None = None
        """The capture; None before `Phase.READY`."""

    @property
    def progress(self) -> Progress:
        """The current progress."""
        if self._begun.phase is not Phase.CONNECTING or self._tap.opened_s is None:
            return self._begun
        elapsed_s = min(self._clock() - self._tap.opened_s, self._begun.seconds)
        return self._begun._replace(
            phase=Phase.CAPTURING, elapsed_s=elapsed_s, packets=self._tap.came
        )

    def start(self, settings: DeviceSettings, seconds: float = SECONDS, source: str = "") -> None:
        """Begin to capture a device; an earlier capture is discarded.

        Parameters
        ----------
        source
            ``a virtual device`` if the device is not real.

        Raises
        ------
        ConfigError
            ``IN_USE`` if a capture is running.
        """
        if self._task is not None and not self._task.done():
            message = "a device is being captured; wait until that ends, or end it"
            raise ConfigError(ConfigReason.IN_USE, message)
        self.draft, self._tap = None, Tap()
        self._begun = Progress(Phase.CONNECTING, settings.sensor, seconds=seconds)
        self._task = asyncio.create_task(self._take(settings, seconds, source))

    async def ended(self) -> None:
        """Wait until no capture is running."""
        if self._task is not None:
            await asyncio.wait([self._task])

    async def discard(self) -> None:
        """End a running capture, and discard its data."""
        if self._task is not None:
            self._task.cancel()
            # nothing is dropped: who captured throws it away
            with suppress(asyncio.CancelledError):
                await self._task
        self.draft, self._begun = None, Progress()

    def save(self, path: Path, note: str = "") -> Path:
        """Save the capture; see `Draft.save`.

        Raises
        ------
        ConfigError
            ``NOT_FOUND`` if there is nothing to save; others as for `Draft.save`.
        """
        if self.draft is None:
            message = "there is no capture to save; start one"
            raise ConfigError(ConfigReason.NOT_FOUND, message)
        file = self.draft.save(path, note)
        self.draft, self._begun = None, Progress()
        return file

    async def _take(self, settings: DeviceSettings, seconds: float, source: str) -> None:
        try:
            taken = await take(settings, seconds, self._tap)
        except GatewayError as error:  # nothing is dropped: the phase says what failed
            self._begun = self._begun._replace(phase=Phase.FAILED, problem=str(error))
        else:
            self.draft = Draft(taken, source)
            self._begun = self.progress._replace(phase=Phase.READY)
