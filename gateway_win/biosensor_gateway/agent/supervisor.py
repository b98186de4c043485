"""Acts on silent streams: enables them again, makes the connection again, or says why not."""

from __future__ import annotations

import asyncio
import math
import random
import time
from asyncio import sleep
from collections import deque
from collections.abc import Callable, Mapping
from typing import cast

import structlog

from biosensor_common.errors import (
    GatewayError,
    ProtocolError,
    ProtocolReason,
    TransportError,
    TransportReason,
)
from biosensor_gateway.agent.state import CONNECTED, State
from biosensor_gateway.devices.driver import Connected, Driver, EnablesAgain
from biosensor_gateway.streaming.silence import PATIENCE_S, Remedy, Silence, limits
from biosensor_gateway.streaming.sink import DeviceSink

TICK_S = 0.25

FRESH_S = 2.0
"""What comes and cannot be read comes now, if some did within so long."""
_KEPT_LOOKS = 1024
_ADVICE = "switch the device off and on"
_UPDATE = "look for an update of its software"


class SilenceRecovery:
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
                    TransportReason.SILENT, f"{message}; the connection is started again"
                )
            if self._sink.is_paused:
                # Nobody misses what would be withheld.
                self._watch.wait_again()
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
            return f"{what}; connecting again" + (f"; {advice}" if silence.attempts else "")
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


PROBE_INTERVAL_S = 1.5
BACKOFF_FIRST_S = 1.0
BACKOFF_CAP_S = 30.0
STABLE_AFTER_S = 30.0
"""A connection that lasted this long clears the memory of earlier failures."""
CLOSE_TIMEOUT_S = 2.0

_PROBED = frozenset({TransportReason.ABSENT, TransportReason.LOST, TransportReason.SILENT})

_log = structlog.get_logger("biosensor_gateway.supervisor")


class Supervisor:
    """Runs drivers for one device, one a connection, until it is stopped.

    Parameters
    ----------
    make_driver
        Makes a driver for one connection.
    sink
        Where drivers put samples; its silence is watched.
    on_state
        Called with every new state.

    Attributes
    ----------
    on_drop
        Called with the reason, in one word, as soon as a connection has ended by itself.
    admit
        Called before each connection; raises what forbids it.
    away_since
        Unix time in s since when it does not stream, for people; None while it does.
    """

    def __init__(
        self,
        make_driver: Callable[[], Driver],
        sink: DeviceSink,
        on_state: Callable[[State], None] = lambda state: None,
    ) -> None:
        self._make_driver = make_driver
        self._sink = sink
        self._on_state = on_state
        self.on_drop: Callable[[str], None] = lambda reason: None
        self.admit: Callable[[], None] = lambda: None
        self._names = {"sensor": sink.identity.sensor, "unit": sink.identity.unit}
        self._delay_s = BACKOFF_FIRST_S
        self.state = State.DISCOVERING
        self.away_since: float | None = time.time()
        self.connections = 0
        self.last_error: str | None = None

    @property
    def is_connected(self) -> bool:
        """Whether the device is connected, and whatever comes from it is passed on."""
        return self.state.value in CONNECTED

    async def run(self) -> None:
        """Keep the device connected; returns only by cancellation, with the device closed."""
        # Whatever a driver logs from now on names its device.
        structlog.contextvars.bind_contextvars(**self._names)
        try:
            while True:
                error = await self._one_connection()
                await self._pause_after(error)
        finally:
            self._enter(State.STOPPED)

    async def _one_connection(self) -> Exception:
        driver: Driver | None = None
        started: float | None = None
        try:
            self.admit()
            driver = self._make_driver()
            self._enter(State.CONNECTING)
            connected = await driver.connect()
            self._sink.silent = connected.silent
            self._sink.open(connected.info, connected.rates)
            self._expect(connected, driver.silence_limit_s)
            self.connections += 1
            if self._sink.watch.is_complete:
                self.last_error = None
            started = self._sink.clock()
            # What had fallen silent before has been enabled with everything else.
            self._enter(State.ENABLING if self._sink.watch.absent else State.STREAMING)
            return self._dropped(await self._stream(driver))
        except asyncio.CancelledError:
            if _is_stopping():
                raise
            # Some libraries cancel their own calls; that must not end the supervisor.
            return TransportError(TransportReason.LOST, "the driver cancelled itself")
        except Exception as error:  # noqa: BLE001 - a failing driver must not end the others
            return error
        finally:
            if started is not None and self._sink.clock() - started >= STABLE_AFTER_S:
                self._delay_s = BACKOFF_FIRST_S
            if driver is not None:
                await self._close(driver)

    async def _stream(self, driver: Driver) -> Exception:
        """Stream until the driver or the watchdog gives up; return why."""
        tasks = [
            asyncio.create_task(driver.stream()),
            asyncio.create_task(SilenceRecovery(driver, self._sink, self._note_silence).run()),
        ]
        try:
            await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        finally:
            for task in tasks:
                task.cancel()
            ended = await asyncio.gather(*tasks, return_exceptions=True)
        for outcome in ended:
            if isinstance(outcome, Exception):
                return _cause(outcome)
        return TransportError(TransportReason.LOST, "the driver stopped by itself")

    def _dropped(self, error: Exception) -> Exception:
        # Closing comes later; it takes time and tells nothing more.
        self.on_drop(_word(error))
        return error

    def _expect(self, connected: Connected, device_limit_s: float) -> None:
        rates = self._sink.spec.rates(connected.rates)
        limits_s = limits(rates, connected.due, connected.patience_s)
        for data_name in connected.silent | connected.refused:
            limits_s.pop(data_name, None)
        self._sink.watch.expect(limits_s, device_limit_s, connected.denied)

    def _note_silence(self, text: str | None, may_help: bool) -> None:
        self.last_error = text
        state = State.ENABLING if may_help else State.STREAMING
        if state is not self.state:
            self._enter(state)

    async def _close(self, driver: Driver) -> None:
        deadline = self._sink.clock() + CLOSE_TIMEOUT_S
        closing = asyncio.create_task(driver.close())
        try:
            await asyncio.wait({closing}, timeout=CLOSE_TIMEOUT_S)
        except asyncio.CancelledError:
            # A stop that comes now must not leave the device half closed.
            await asyncio.wait({closing}, timeout=max(0.0, deadline - self._sink.clock()))
            raise
        finally:
            self._report_closing(closing)

    def _report_closing(self, closing: asyncio.Task[None]) -> None:
        # Whatever went wrong, the connection is over.
        if not closing.done():
            closing.cancel()
            _log.warning("closing takes too long; it is left to itself", **self._names)
        elif not closing.cancelled() and (error := closing.exception()) is not None:
            _log.warning("closing failed", **self._names, error=str(error))

    async def _pause_after(self, error: Exception) -> None:
        self._report(error)
        if isinstance(error, TransportError) and error.reason in _PROBED:
            self._enter(State.DISCOVERING)
            await sleep(PROBE_INTERVAL_S)
        else:
            self._enter(State.BACKOFF)
            delay, self._delay_s = self._delay_s, min(BACKOFF_CAP_S, 2 * self._delay_s)
            # Jitter keeps several devices from knocking at one radio in step.
            await sleep(delay * random.uniform(0.75, 1.0))  # noqa: S311 - no secret

    def _report(self, error: Exception) -> None:
        text = str(error) or type(error).__name__
        if isinstance(error, GatewayError):
            # Probing repeats the same sentence for hours; once is enough.
            if text != self.last_error:
                _log.warning(text, **self._names, reason=str(error.reason.value))
        else:
            _log.error("the driver failed", **self._names, exc_info=error)
        self.last_error = text

    def _enter(self, state: State) -> None:
        self.state = state
        if state is State.STREAMING:
            self.away_since = None
        elif self.away_since is None:
            self.away_since = time.time()
        self._on_state(state)
        _log.debug("state", **self._names, state=state.value)


def _is_stopping() -> bool:
    task = asyncio.current_task()
    return task is not None and task.cancelling() > 0


def _word(error: Exception) -> str:
    return str(error.reason.value) if isinstance(error, GatewayError) else "failed"


def _cause(error: Exception) -> Exception:
    """Unwrap what a driver's task group raised.

    When a link is cut, several tasks may notice at once: one that says so is enough.
    """
    if not isinstance(error, ExceptionGroup):
        return error
    group = cast("ExceptionGroup[Exception]", error)
    causes = [_cause(each) for each in group.exceptions]
    unexpected = [each for each in causes if not isinstance(each, GatewayError)]
    if not unexpected:
        return causes[0]
    return unexpected[0] if len(causes) == 1 else group
