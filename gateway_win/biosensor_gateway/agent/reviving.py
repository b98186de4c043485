"""Acts on silent streams: enables them again, makes the connection anew, or says why not."""

from __future__ import annotations

import asyncio
import math
from collections import deque
from collections.abc import Callable, Mapping

import structlog

from biosensor_common.errors import (
    ProtocolError,
    ProtocolReason,
    TransportError,
    TransportReason,
)
from biosensor_gateway.devices.driver import Driver, EnablesAgain
from biosensor_gateway.streaming.silence import PATIENCE_S, Remedy, Silence
from biosensor_gateway.streaming.sink import DeviceSink

TICK_S = 0.25

FRESH_S = 2.0
"""What comes and cannot be read comes now, if some did within so long."""
_KEPT_LOOKS = 1024
_ADVICE = "switch the device off and on"
_UPDATE = "look for an update of its software"

_log = structlog.get_logger("biosensor_gateway.supervisor")


class Reviver:
    """Looks after the streams of one connection.

    Parameters
    ----------
    driver
        May implement :class:`~biosensor_gateway.devices.driver.EnablesAgain`.
    sink
        Knows what is silent.
    on_change
        Called with what is wrong, None when nothing is any more; and with whether
        something is being done about it that may still help.
    """

    def __init__(
        self, driver: Driver, sink: DeviceSink, on_change: Callable[[str | None, bool], None]
    ) -> None:
        self._driver = driver
        self._sink = sink
        self._watch = sink.watch
        self._on_change = on_change
        self._limit_s = driver.silence_limit_s
        self._names = {"sensor": sink.identity.sensor, "unit": sink.identity.unit}
        self._unreadable = _Unreadable(sink)
        self._told: str | None = None
        self._remarked: tuple[str, ...] = ()

    async def run(self) -> None:
        """Look after them until cancelled.

        Raises
        ------
        TransportError
            ``SILENT``: a new connection is needed.
        """
        self._tell_denied()
        while True:
            await asyncio.sleep(min(TICK_S, self._limit_s))
            self._unreadable.look()
            self._welcome(self._watch.take_came_back())
            self._tell_remarks()
            if self._watch.is_device_silent:
                message = f"nothing from the device for {self._limit_s:.0f} s"
                message += self._unreadable.since(self._limit_s)
                raise TransportError(
                    TransportReason.SILENT, f"{message}; the connection is started anew"
                )
            if self._sink.is_paused:
                # Nobody misses what would be withheld.
                self._watch.wait_anew()
                continue
            silence = self._watch.judge(
                can_enable=isinstance(self._driver, EnablesAgain), patience_s=self._patience_s()
            )
            if silence is not None:
                await self._act(silence)

    def _welcome(self, came_back: frozenset[str]) -> None:
        if came_back:
            self._sink.tell_came_back(came_back)
            _log.info("data come again", **self._names, streams=sorted(came_back))
        if came_back and not self._watch.absent:
            self._told = None
            self._on_change(self._standing(), False)

    def _patience_s(self) -> float:
        """How long streams may be absent now: one that sends what nobody can read is not late."""
        is_foreign = (
            self._watch.device_silence_s >= PATIENCE_S and self._unreadable.count(FRESH_S) > 0
        )
        return PATIENCE_S if is_foreign else math.inf

    def _tell_denied(self) -> None:
        denied = self._watch.denied
        if not denied:
            return
        for why, streams in _by_reason(denied).items():
            self._sink.tell_silent(Silence(frozenset(streams), 0.0, Remedy.NONE, why=why))
        text = _denial(denied)
        _log.warning(text, **self._names, reason=ProtocolReason.REFUSED.value)
        if not self._watch.absent:
            self._on_change(text, False)

    def _standing(self) -> str | None:
        """Return what is wrong although all that can come comes; None if that is nothing."""
        found = [_denial(self._watch.denied), *self._watch.remarks.values()]
        return "; ".join(each for each in found if each) or None

    def _tell_remarks(self) -> None:
        remarks = tuple(self._watch.remarks.values())
        if remarks == self._remarked:
            return
        kinds = {_kind(each) for each in self._remarked}
        for each in remarks:
            # The numbers differ each time.
            if _kind(each) not in kinds:
                _log.warning(each, **self._names)
        self._remarked = remarks
        if not self._watch.absent:
            self._on_change(self._standing(), False)

    async def _act(self, silence: Silence) -> None:
        self._sink.tell_silent(silence)
        text = self._sentence(silence)
        if silence.remedy is Remedy.RECONNECT:
            raise TransportError(TransportReason.SILENT, text)
        # A stream that stays away is tried again and again; it is said once.
        if silence.attempts == 0 or silence.remedy is Remedy.NONE:
            self._say(text)
        self._on_change(self._told or text, silence.remedy is Remedy.ENABLE)
        if silence.remedy is Remedy.ENABLE:
            await self._enable(silence)

    async def _enable(self, silence: Silence) -> None:
        assert isinstance(self._driver, EnablesAgain)
        try:
            await self._driver.enable_again(silence.streams)
        except ProtocolError as error:
            raise TransportError(TransportReason.SILENT, str(error)) from error
        self._watch.enabled_again(silence.streams)

    def _say(self, text: str) -> None:
        # The seconds differ each time.
        if self._told is None or _kind(text) != _kind(self._told):
            _log.warning(text, **self._names, reason=TransportReason.SILENT.value)
            self._told = text

    def _sentence(self, silence: Silence) -> str:
        streams = ", ".join(sorted(silence.streams))
        what = f"connected, but no data of {streams} for {silence.seconds:.0f} s"
        unreadable = self._unreadable.since(silence.seconds)
        what += unreadable
        advice = _UPDATE if unreadable else _ADVICE
        if silence.remedy is Remedy.ENABLE:
            return f"{what}; enabling again"
        if silence.remedy is Remedy.RECONNECT:
            return f"{what}; connecting anew" + (f"; {advice}" if silence.attempts else "")
        return f"{what}, whatever the agent does; {advice}"


class _Unreadable:
    """Bytes of a device that made no valid message, by when they came."""

    def __init__(self, sink: DeviceSink) -> None:
        self._sink = sink
        self._seen = deque([(sink.clock(), sink.dropped_bytes)], maxlen=_KEPT_LOOKS)

    def look(self) -> None:
        """Note how many there are now."""
        self._seen.append((self._sink.clock(), self._sink.dropped_bytes))

    def count(self, seconds: float) -> int:
        """Return how many came in the last seconds, as far as is known."""
        begin_s = self._sink.clock() - seconds
        before = next((n for time_s, n in reversed(self._seen) if time_s <= begin_s), None)
        return self._sink.dropped_bytes - (self._seen[0][1] if before is None else before)

    def since(self, seconds: float) -> str:
        """Say so; empty if there were none."""
        count = self.count(seconds)
        return f" ({count} bytes came that cannot be read)" if count else ""


def _denial(denied: Mapping[str, str]) -> str | None:
    """Say what the device refuses; None if that is nothing."""
    if not denied:
        return None
    parts = (f"{', '.join(names)} ({why})" for why, names in _by_reason(denied).items())
    return f"connected, but the device refuses {'; '.join(parts)}"


def _by_reason(denied: Mapping[str, str]) -> dict[str, list[str]]:
    return {
        why: sorted(name for name, each in denied.items() if each == why)
        for why in sorted(set(denied.values()))
    }


def _kind(text: str) -> str:
    return "".join(letter for letter in text if not letter.isdigit())
