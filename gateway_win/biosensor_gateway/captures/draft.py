"""A capture that nobody has agreed to yet: what it holds is shown, then it is saved or thrown away.

The command line makes one with :func:`~biosensor_gateway.captures.recorder.take`. A page has a
:class:`CaptureDesk`: it calls ``start``, shows ``progress`` as often as it likes, and once that is
``READY`` shows ``draft.lines``, ``draft.problems`` and `CONSENT`, with ``draft.whole`` for whoever
wants to see everything. Then it calls ``save`` or ``discard``. Nothing is written before, and
nothing is ever sent.
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
from biosensor_gateway.captures.recorder import Recorder, Taken, take
from biosensor_gateway.settings.models import DeviceSettings
from biosensor_gateway.system.clock import LSL_CLOCK, Clock

SECONDS = 60.0
"""So long is listened, unless somebody wants it otherwise."""
CONSENT = (
    "An electrocardiogram, a pulse wave, an EEG and the way a person moves can identify this "
    "person, as a fingerprint can, without any name. The file will be public, for anybody and for "
    "good: under the licence CC0-1.0, which gives up all rights, nobody can take it back. So send "
    "it only if you wore the device, or if whoever wore it knows all this and agrees; for a child, "
    "the parents."
)
AGREED = "Whoever wore the device has agreed that it is public under CC0-1.0."
HOW_TO_SEND = 'To send it, open an issue of the kind "A capture of a device" and attach the file.'
MOST_NOTE = 300
"""Characters of what somebody adds."""
_SHOWN_BYTES = 24
_SHOWN_CHARACTERS = 40
_UNFIT = re.compile(r"[^A-Za-z0-9.]+")


class Draft:
    """A capture before its consent.

    Parameters
    ----------
    taken
    source
        Where the bytes come from, if not from a real device.
    """

    def __init__(self, taken: Taken, source: str = "") -> None:
        self._taken, self._source = taken, source

    @property
    def problems(self) -> list[str]:
        """What the driver found wrong with the device, one sentence each."""
        return self._taken.test.problems

    @property
    def lines(self) -> list[str]:
        """What would leave this computer, and what was replaced in it; some are indented."""
        return [*_contents(self._taken.capture), *_replaced(self._taken)]

    def whole(self) -> Iterator[str]:
        """Yield each line of the file as it would be saved, as JSON."""
        yield self._taken.capture.header.model_dump_json()
        for event in self._taken.capture.events:
            yield event.model_dump_json(exclude_defaults=True)

    def save(self, path: Path, note: str = "") -> Path:
        """Write the file, with the consent in it; only for what somebody has agreed to.

        Parameters
        ----------
        path
            Of a file that is not there yet, or a folder that is.
        note
            What whoever recorded it adds, without names; cut after `MOST_NOTE`.

        Raises
        ------
        ConfigError
            ``EXISTS``: there is such a file; ``UNREADABLE``: it cannot be written.
        """
        update = {"consent": AGREED, "note": note[:MOST_NOTE], "source": self._source}
        capture = self._taken.capture
        header = capture.header.model_copy(update=update)
        content = packed(capture.model_copy(update={"header": header}))
        file = path / file_name(capture) if path.is_dir() else path
        try:
            with file.open("xb") as opened:
                opened.write(content)
        except FileExistsError as error:
            message = f"there is a file {file} already; choose another name"
            raise ConfigError(ConfigReason.EXISTS, message) from error
        except OSError as error:
            message = f"{file} cannot be written ({error.strerror}); choose another place"
            raise ConfigError(ConfigReason.UNREADABLE, message) from error
        return file.resolve()


def file_name(capture: Capture) -> str:
    """Return a name for the file that tells what it is of, and not whose."""
    header = capture.header
    parts = (header.sensor, header.model, header.firmware, token_hex(2))
    return "-".join(_UNFIT.sub("_", each) for each in parts if each) + ENDING


def _contents(capture: Capture) -> Iterator[str]:
    header = capture.header
    yield "This is what the file holds:"
    known = (header.manufacturer, header.model, header.firmware)
    yield f"  device: {header.sensor}, {', '.join(filter(None, known)) or 'nothing known of it'}"
    yield f"  computer: {header.system}; {header.radio}; biosensor-gateway {header.gateway}"
    yield f"  month: {header.recorded}; length: {header.seconds:g} s"
    if header.settings:
        yield f"  settings: {json.dumps(header.settings)}"
    if header.left_out:
        yield f"  left out of the settings: {', '.join(header.left_out)}"
    seen = capture.events[0].seen
    if seen is not None:
        yield f"  advertised: {seen.name or 'no name'}, {seen.address}"
    yield "  what passed, with the time of each, and the first of it:"
    groups: dict[tuple[str, str], list[bytes]] = {}
    for event in capture.events:
        groups.setdefault((event.what.value, event.at), []).append(event.bytes)
    for (what, at), packets in groups.items():
        size = sum(map(len, packets))
        first = _first_bytes(next(filter(None, packets), b""))
        yield f"    {what} {at}".rstrip() + f": {len(packets)} times, {size} bytes; {first}"
    yield "The device's own clock is in it as it is, which may tell date and time."


def _first_bytes(packet: bytes) -> str:
    shown = packet[:_SHOWN_BYTES]
    text = shown.decode("ascii", "replace").rstrip("\r\n")
    return text if text.isascii() and text.isprintable() else shown.hex(" ")


def _replaced(taken: Taken) -> Iterator[str]:
    yield "Replaced:" if taken.replaced else "There was nothing to replace."
    for each in taken.replaced:
        found = f", {each.times} times in what passed" if each.times else ""
        if each.kind == "secret":
            yield f"    a secret of {len(each.secret)} characters{found}"
        else:
            yield f"    {each.kind}: {_short(each.secret)} became {_short(each.pseudonym)}{found}"
    if taken.replaced:
        yield "The file was searched for each of them: none is left."


def _short(text: str) -> str:
    return text if len(text) <= _SHOWN_CHARACTERS else f"{text[:_SHOWN_CHARACTERS]}..."


class Phase(StrEnum):
    """How far a capture is."""

    NONE = "none"
    CONNECTING = "connecting"
    CAPTURING = "capturing"
    READY = "ready"
    FAILED = "failed"


class Progress(NamedTuple):
    """What a page shows of a capture.

    Attributes
    ----------
    sensor
        Whose; empty if there is none.
    elapsed_s, seconds
        Since the device was connected, and how long it takes from then on.
    packets
        How many have come from the device.
    problem
        Why it failed: a sentence.
    """

    phase: Phase = Phase.NONE
    sensor: str = ""
    elapsed_s: float = 0.0
    seconds: float = 0.0
    packets: int = 0
    problem: str = ""


class CaptureDesk:
    """One capture at a time: started, watched, shown, then saved or thrown away.

    Used in one event loop, which goes on meanwhile. The agent must not be connected to the device:
    who calls sees to that, as for the test of a device.
    """

    def __init__(self, clock: Clock = LSL_CLOCK) -> None:
        self._clock = clock
        self._task: asyncio.Task[None] | None = None
        self._recorder = Recorder()
        self._begun = Progress()
        self.draft: Draft | None = None
        """What was captured; None before `Phase.READY`."""

    @property
    def progress(self) -> Progress:
        """How far it is now."""
        if self._begun.phase is not Phase.CONNECTING or self._recorder.opened_s is None:
            return self._begun
        elapsed_s = min(self._clock() - self._recorder.opened_s, self._begun.seconds)
        return self._begun._replace(
            phase=Phase.CAPTURING, elapsed_s=elapsed_s, packets=self._recorder.came
        )

    def start(self, settings: DeviceSettings, seconds: float = SECONDS, source: str = "") -> None:
        """Begin to capture a device; what was captured before is thrown away.

        Parameters
        ----------
        source
            ``a virtual device``, if it is none that is real.

        Raises
        ------
        ConfigError
            ``IN_USE``: another one goes on.
        """
        if self._task is not None and not self._task.done():
            message = "a device is being captured; wait for its end, or end it"
            raise ConfigError(ConfigReason.IN_USE, message)
        self.draft, self._recorder = None, Recorder()
        self._begun = Progress(Phase.CONNECTING, settings.sensor, seconds=seconds)
        self._task = asyncio.create_task(self._take(settings, seconds, source))

    async def ended(self) -> None:
        """Wait until nothing is being captured any more."""
        if self._task is not None:
            await asyncio.wait([self._task])

    async def discard(self) -> None:
        """Throw away what was captured, also in the midst of it; without effect if nothing was."""
        if self._task is not None:
            self._task.cancel()
            # nothing is dropped: who captured throws it away
            with suppress(asyncio.CancelledError):
                await self._task
        self.draft, self._begun = None, Progress()

    def save(self, path: Path, note: str = "") -> Path:
        """Save what was shown, and be ready for another; see `Draft.save`.

        Raises
        ------
        ConfigError
            ``NOT_FOUND``: there is nothing to save; others as for `Draft.save`.
        """
        if self.draft is None:
            message = "there is no capture to save; begin one"
            raise ConfigError(ConfigReason.NOT_FOUND, message)
        file = self.draft.save(path, note)
        self.draft, self._begun = None, Progress()
        return file

    async def _take(self, settings: DeviceSettings, seconds: float, source: str) -> None:
        try:
            taken = await take(settings, seconds, self._recorder)
        except GatewayError as error:  # nothing is dropped: the phase says what failed
            self._begun = self._begun._replace(phase=Phase.FAILED, problem=str(error))
        else:
            self.draft = Draft(taken, source)
            self._begun = self.progress._replace(phase=Phase.READY)
