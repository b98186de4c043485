"""Keeps one device connected: an explicit state machine around a driver.

::

    DISCOVERING --attempt--> CONNECTING --connected--> STREAMING
         ^                    |      |                  |     |
         |      absent, lost, |      | refused, busy,   |     |
         +--------silent------+      | protocol broken  |     |
         +---------------------------|------------------+     |
                                     v                        |
                                  BACKOFF <-------------------+
                                     |
                                     +--waited--> CONNECTING

    STREAMING --data that are due do not come--> ENABLING --they come--> STREAMING
    ENABLING --they do not--> DISCOVERING, or STREAMING with a reason where others flow

Every state goes to STOPPED when asked to stop. What is absent is probed every
two seconds, so that a device that is switched on is streaming soon; what
answers and refuses is left alone for longer and longer.
"""

from __future__ import annotations

import asyncio
import random
import time
from asyncio import sleep
from collections.abc import Callable
from typing import cast

import structlog

from biosensor_common.errors import GatewayError, TransportError, TransportReason
from biosensor_gateway.agent.reviving import Reviver
from biosensor_gateway.agent.state import CONNECTED, State
from biosensor_gateway.devices.driver import Connected, Driver
from biosensor_gateway.streaming.silence import limits
from biosensor_gateway.streaming.sink import DeviceSink

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
            asyncio.create_task(Reviver(driver, self._sink, self._note_silence).run()),
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
