"""Keeps a device connected, and recovers streams that fall silent."""

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
from biosensor_gateway.agent.device_states import CONNECTED, State
from biosensor_gateway.devices.driver import Connected, Driver, EnablesAgain
from biosensor_gateway.streaming.silence import PATIENCE_S, Remedy, Silence, limits
from biosensor_gateway.streaming.sink import DeviceSink
from biosensor_gateway.system.device_log import names_in_log

TICK_S = 0.25

FRESH_S = 2.0
"""Bytes that could not be read count as current for this long."""
_KEPT_LOOKS = 1024
_ADVICE = "switch the device off and on"
_UPDATE = "look for an update of its software"


class SilenceRecovery:
    """Enables silent streams of a connection again, or ends the connection.

    Parameters
    ----------
    driver
        May implement :class:`~biosensor_gateway.devices.driver.EnablesAgain`.
    on_change
        Called with the problem, or None when it is over; and with whether enabling again may
        still solve it.
    """

    def __init__(
        self, driver: Driver, sink: DeviceSink, on_change: Callable[[str | None, bool], None]
    ) -> None:
        self._driver = driver
        self._sink = sink
        self._watch = sink.watch
        self._on_change = on_change
        self._limit_s = driver.silence_limit_s
        self._names = names_in_log(sink.identity)
        self._unreadable = _Unreadable(sink)
        self._reported: str | None = None
        self._remarked: tuple[str, ...] = ()

    async def run(self) -> None:
        """Watch the streams until cancelled.

        Raises
        ------
        TransportError
            ``SILENT`` if a new connection is needed.
        """
        self._report_denied()
        while True:
            await asyncio.sleep(min(TICK_S, self._limit_s))
            self._unreadable.look()
            self._report_recovered(self._watch.take_came_back())
            self._report_remarks()
            if self._watch.is_device_silent:
                message = f"nothing from the device for {self._limit_s:.0f} s"
                message += self._unreadable.since(self._limit_s)
                raise TransportError(
                    TransportReason.SILENT, f"{message}; the connection is restarted"
                )
            if self._sink.is_paused:
                # While it is paused, samples would be suppressed anyway.
                self._watch.wait_again()
                continue
            silence = self._watch.judge(
                can_enable=isinstance(self._driver, EnablesAgain), patience_s=self._patience_s()
            )
            if silence is not None:
                await self._act(silence)

    def _report_recovered(self, came_back: frozenset[str]) -> None:
        if came_back:
            self._sink.tell_came_back(came_back)
            _log.info("data come again", **self._names, streams=sorted(came_back))
        if came_back and not self._watch.absent:
            self._reported = None
            self._on_change(self._remaining_problem(), False)

    def _patience_s(self) -> float:
        """Return how long streams may be absent, limited while only unreadable bytes arrive.

        Then the device does send, and waiting longer would not help.
        """
        is_foreign = (
            self._watch.device_silence_s >= PATIENCE_S and self._unreadable.count(FRESH_S) > 0
        )
        return PATIENCE_S if is_foreign else math.inf

    def _report_denied(self) -> None:
        denied = self._watch.denied
        if not denied:
            return
        for why, streams in _by_reason(denied).items():
            self._sink.tell_silent(Silence(frozenset(streams), 0.0, Remedy.NONE, why=why))
        text = _denial(denied)
        _log.warning(text, **self._names, reason=ProtocolReason.REFUSED.value)
        if not self._watch.absent:
            self._on_change(text, False)

    def _remaining_problem(self) -> str | None:
        """Return the problem that remains when no stream is silent; None if there is none."""
        found = [_denial(self._watch.denied), *self._watch.remarks.values()]
        return "; ".join(each for each in found if each) or None

    def _report_remarks(self) -> None:
        remarks = tuple(self._watch.remarks.values())
        if remarks == self._remarked:
            return
        kinds = {_kind(each) for each in self._remarked}
        for each in remarks:
            # Compared without numbers, which differ each time.
            if _kind(each) not in kinds:
                _log.warning(each, **self._names)
        self._remarked = remarks
        if not self._watch.absent:
            self._on_change(self._remaining_problem(), False)

    async def _act(self, silence: Silence) -> None:
        self._sink.tell_silent(silence)
        text = self._sentence(silence)
        if silence.remedy is Remedy.RECONNECT:
            raise TransportError(TransportReason.SILENT, text)
        # A silent stream is enabled again and again; only the first attempt is logged.
        if silence.attempts == 0 or silence.remedy is Remedy.NONE:
            self._report(text)
        self._on_change(self._reported or text, silence.remedy is Remedy.ENABLE)
        if silence.remedy is Remedy.ENABLE:
            await self._enable(silence)

    async def _enable(self, silence: Silence) -> None:
        assert isinstance(self._driver, EnablesAgain)
        try:
            await self._driver.enable_again(silence.streams)
        except ProtocolError as error:
            raise TransportError(TransportReason.SILENT, str(error)) from error
        self._watch.enabled_again(silence.streams)

    def _report(self, text: str) -> None:
        # Compared without the seconds, which differ each time.
        if self._reported is None or _kind(text) != _kind(self._reported):
            _log.warning(text, **self._names, reason=TransportReason.SILENT.value)
            self._reported = text

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
    """Counts a device's bytes that were not part of a valid message, over time."""

    def __init__(self, sink: DeviceSink) -> None:
        self._sink = sink
        self._seen = deque([(sink.clock(), sink.dropped_bytes)], maxlen=_KEPT_LOOKS)

    def look(self) -> None:
        """Note the current count."""
        self._seen.append((self._sink.clock(), self._sink.dropped_bytes))

    def count(self, seconds: float) -> int:
        """Return the number of bytes in the last *seconds*, as far back as it was noted."""
        begin_s = self._sink.clock() - seconds
        before = next((n for time_s, n in reversed(self._seen) if time_s <= begin_s), None)
        return self._sink.dropped_bytes - (self._seen[0][1] if before is None else before)

    def since(self, seconds: float) -> str:
        """Return the number in the last *seconds* as text; empty if it is 0."""
        count = self.count(seconds)
        return f" ({count} unreadable bytes came)" if count else ""


def _denial(denied: Mapping[str, str]) -> str | None:
    """Return which streams the device refuses, and why; None if it refuses none."""
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
"""A connection that lasted this long resets the back-off."""
CLOSE_TIMEOUT_S = 2.0

_PROBED = frozenset({TransportReason.ABSENT, TransportReason.LOST, TransportReason.SILENT})

_log = structlog.get_logger("biosensor_gateway.supervisor")


class Supervisor:
    """Keeps one device connected, with a new driver for each connection.

    Parameters
    ----------
    sink
        Receives the drivers' samples; its silent streams are recovered.
    on_state
        Called with every new state.
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
        # Called with the reason, in one word, as soon as a connection has ended by itself.
        self.on_drop: Callable[[str], None] = lambda reason: None
        # Called before each connection; raises an exception to forbid it.
        self.admit: Callable[[], None] = lambda: None
        self._names = names_in_log(sink.identity)
        self._delay_s = BACKOFF_FIRST_S
        self.state = State.DISCOVERING
        # Unix time in s since when the device does not stream; None while it streams.
        self.away_since: float | None = time.time()
        self.connections = 0
        self.last_error: str | None = None

    @property
    def is_connected(self) -> bool:
        """Whether the device is connected, and its samples are passed on."""
        return self.state.value in CONNECTED

    async def run(self) -> None:
        """Keep the device connected until cancelled; then close it."""
        # The driver's log entries then have the device's name.
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
            # Streams that were silent in the last connection were enabled again by the new one.
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
        return TransportError(TransportReason.LOST, "the driver stopped unexpectedly")

    def _dropped(self, error: Exception) -> Exception:
        # Before closing, which takes time and does not change the reason.
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
        # Only logged: the connection is over in any case.
        if not closing.done():
            closing.cancel()
            _log.warning("closing takes too long; it is no longer waited for", **self._names)
        elif not closing.cancelled() and (error := closing.exception()) is not None:
            _log.warning("closing failed", **self._names, error=str(error))

    async def _pause_after(self, error: Exception) -> None:
        self._log_error(error)
        if isinstance(error, TransportError) and error.reason in _PROBED:
            self._enter(State.DISCOVERING)
            await sleep(PROBE_INTERVAL_S)
        else:
            self._enter(State.BACKOFF)
            delay, self._delay_s = self._delay_s, min(BACKOFF_CAP_S, 2 * self._delay_s)
            # Jitter keeps several devices from retrying on one radio at the same time.
            await sleep(delay * random.uniform(0.75, 1.0))  # noqa: S311 - no secret

    def _log_error(self, error: Exception) -> None:
        text = str(error) or type(error).__name__
        if isinstance(error, GatewayError):
            # Logged once: probing would repeat the same sentence for hours.
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
    """Unwrap the exception of a driver's task group.

    When a link is lost, several tasks may raise at once; the first of these errors is enough.
    """
    if not isinstance(error, ExceptionGroup):
        return error
    group = cast("ExceptionGroup[Exception]", error)
    causes = [_cause(each) for each in group.exceptions]
    unexpected = [each for each in causes if not isinstance(each, GatewayError)]
    if not unexpected:
        return causes[0]
    return unexpected[0] if len(causes) == 1 else group
