"""Driver for line sensors; reports lines that do not match the settings."""

from __future__ import annotations

import asyncio
import errno
import math
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from math import isnan
from typing import TYPE_CHECKING, Protocol

from biosensor_common.errors import ProtocolError, ProtocolReason, TransportError, TransportReason
from biosensor_common.spec import SensorSpec
from biosensor_gateway.devices.driver import Connected, DriverEntry, own_settings
from biosensor_gateway.devices.line_sensor.driver.emitter import LineEmitter
from biosensor_gateway.devices.line_sensor.driver.openearable import Asked, OpenEarableLink
from biosensor_gateway.devices.line_sensor.driver.protocol import (
    BadLine,
    CsvReader,
    Flaw,
    FrameProtocol,
    JsonReader,
    LineProtocol,
    Row,
    RowProtocol,
    checked_format,
)
from biosensor_gateway.devices.line_sensor.driver.settings import TICKS_S, LineSettings
from biosensor_gateway.settings.models import DeviceSettings
from biosensor_gateway.system.device_log import DeviceLog, Once
from biosensor_gateway.transports.byte_links import byte_link
from biosensor_gateway.transports.link import Address, ByteLink, Early, Received
from biosensor_gateway.transports.ports import UdpPort
from biosensor_gateway.transports.tap import byte_link_of, text_link_of
from biosensor_gateway.transports.websocket import WebSocketLink

if TYPE_CHECKING:
    from biosensor_gateway.streaming.sink import DeviceSink

PATIENCE_S = 0.35
"""How long a line waits for an earlier one, as for other datagram senders."""
MOST_AHEAD = 32
"""A line further ahead did not overtake others: lines were lost, or the count restarted."""


class InOrder:
    """Returns lines in the order of their count.

    Parameters
    ----------
    at_count
        Position of the count in a row; None without a count or on an ordered transport.
    """

    def __init__(self, at_count: int | None) -> None:
        self.is_needed = at_count is not None  # Whether lines may have to wait.
        self._at_count = at_count
        self._last: float | None = None
        self._waiting: dict[float, tuple[Row, float]] = {}

    def take(self, rows: Iterable[Row], arrival_s: float) -> Iterator[tuple[Row, float]]:
        """Add rows; yield those in order now, each with its own arrival."""
        for row in rows:
            if self._at_count is None or isnan(row[self._at_count]):
                yield row, arrival_s
            else:
                yield from self._placed(row, row[self._at_count], arrival_s)

    def end(self) -> list[tuple[Row, float]]:
        """Return the waiting rows, and restart with the next row."""
        left = [self._hand_out(count) for count in sorted(self._waiting)]
        self._last = None
        return left

    def _placed(self, row: Row, count: float, arrival_s: float) -> Iterator[tuple[Row, float]]:
        ahead = 1.0 if self._last is None else count - self._last
        if count in self._waiting or -MOST_AHEAD <= ahead < 1:
            # Repeated or too late; the emitter decides by its count.
            yield row, arrival_s
            return
        if ahead > MOST_AHEAD or ahead < 1:
            yield from self.end()
        self._waiting[count] = row, arrival_s
        while self._waiting and self._is_ripe(min(self._waiting), arrival_s):
            yield self._hand_out(min(self._waiting))

    def _is_ripe(self, count: float, now_s: float) -> bool:
        is_next = self._last is None or count == self._last + 1
        return is_next or now_s - self._waiting[count][1] > PATIENCE_S

    def _hand_out(self, count: float) -> tuple[Row, float]:
        self._last = count
        return self._waiting.pop(count)


WINDOW_S = 5.0
TOLERANCE = 0.1
"""Sketches with delays between lines are a little slower than intended."""


class LineRate:
    """Measures the rate of lines, by their count and time if available.

    Parameters
    ----------
    settings
        Contain the expected rate; 0 disables the comparison.
    """

    def __init__(self, settings: LineSettings) -> None:
        self._nominal_hz = settings.rate_hz
        self._at_count = settings.position(settings.sequence_column)
        self._at_time = settings.position(settings.time_column)
        self._tick_s = 1.0
        if self._at_time is not None:
            self._tick_s = TICKS_S[settings.parsed_columns[self._at_time].unit]
        # What is wrong with the rate and what to do; empty if right or unknown.
        self.complaint = ""
        self.begin()

    def begin(self) -> None:
        """Restart the measurement, for example for a new connection."""
        self._first: tuple[float, float] | None = None
        self._lines = 0
        self._wrong_hz = 0.0
        self.complaint = ""

    def take(self, rows: Sequence[Row], arrival_s: float) -> None:
        """Add rows that arrived together."""
        if not self._nominal_hz or not rows:
            return  # nothing is dropped: this only looks on
        self._lines += len(rows)
        last = rows[-1]
        count = self._lines if self._at_count is None else last[self._at_count]
        time_s = arrival_s if self._at_time is None else last[self._at_time] * self._tick_s
        if isnan(count) or isnan(time_s):
            return  # nothing is dropped: this only looks on
        first_count, first_s = self._first or (count, time_s)
        if self._first is None or count < first_count or time_s < first_s:
            self._first = count, time_s
        elif time_s - first_s >= WINDOW_S:
            self._judge((count - first_count) / (time_s - first_s))
            self._first = count, time_s

    def _judge(self, hz: float) -> None:
        """Report a wrong rate only the second time, because delayed lines come faster once."""
        if abs(hz / self._nominal_hz - 1) <= TOLERANCE:
            self._wrong_hz, self.complaint = 0.0, ""
            return
        if self._wrong_hz and abs(hz / self._wrong_hz - 1) <= TOLERANCE:
            self.complaint = (
                f"lines come {hz:.3g} times per second, but the setting `rate_hz` is "
                f"{self._nominal_hz:g}; set `rate_hz = {hz:.3g}`"
            )
        self._wrong_hz = hz


FIRST_LINE_LIMIT_S = 6.0
"""An Arduino that is reset by opening its port starts after two seconds."""
MOST_BAD = 100
"""A board prints fewer invalid lines than this while it starts."""
_SOME_LINES = 3.0


class LineDriver:
    """One connection; see :class:`~biosensor_gateway.devices.driver.Driver`."""

    def __init__(self, settings: LineSettings, sink: DeviceSink, emitter: LineEmitter) -> None:
        self._settings = settings
        self._where = _where(settings)
        self._sink = sink
        self._emitter = emitter
        self._link = line_link(settings)
        self._protocol = row_protocol(settings)
        may_overtake = settings.udp_port is not None
        at_count = settings.position(settings.sequence_column) if may_overtake else None
        self._in_order = InOrder(at_count)
        self._rate = LineRate(settings)
        self._log = DeviceLog("biosensor_gateway.line_sensor", sink.identity)
        self._is_new = Once()
        # Connecting ends with the first valid read.
        self._early = Early[tuple[list[Row], float]](1)
        self._came_bytes = 0
        rate_hz = settings.rate_hz
        self._wait_s = max(FIRST_LINE_LIMIT_S, _SOME_LINES / rate_hz if rate_hz else 0.0)
        # Irregular lines may be absent for any time.
        self.silence_limit_s = max(10.0, 20.0 / rate_hz) if rate_hz else math.inf

    async def connect(self) -> Connected:
        """Open the link; if lines have a rate, wait for a valid one."""
        await self._link.open()
        if self._settings.start_command:
            await self._link.send(self._settings.start_command)
        bad: list[BadLine] = []
        try:
            async with asyncio.timeout(self._wait_s):
                while not self._early and len(bad) < MOST_BAD:
                    bad += await self._first()
        except TimeoutError:
            pass
        if not self._early and (bad or self._settings.rate_hz):
            raise self._unfit(bad)
        return Connected()

    async def stream(self) -> None:
        """Emit data received since connecting."""
        self._emitter.connected()
        self._rate.begin()
        for rows, arrival_s in self._early.take():
            self._take(rows, arrival_s)
        while True:
            rows, bad, arrival_s = await self._read()
            self._take(rows, arrival_s)
            for each in bad:
                self._say(each)

    async def close(self) -> None:
        """Emit waiting lines, and close the link."""
        for row, arrival_s in self._in_order.end():
            self._emitter.take([row], arrival_s)
        self._emitter.ended()
        await self._link.close()

    def _take(self, rows: Sequence[Row], arrival_s: float) -> None:
        self._rate.take(rows, arrival_s)
        self._sink.remark("rate", self._rate.complaint)
        if not self._in_order.is_needed:
            self._emitter.take(rows, arrival_s)
            return
        for row, came_s in self._in_order.take(rows, arrival_s):
            self._emitter.take([row], came_s)

    async def _first(self) -> list[BadLine]:
        rows, bad, arrival_s = await self._read()
        if rows:
            self._early.keep((rows, arrival_s))
        return bad

    async def _read(self) -> tuple[list[Row], list[BadLine], float]:
        data, arrival_s = await self._link.read()
        self._came_bytes += len(data)
        protocol = self._protocol
        found = protocol.feed_whole(data) if self._link.in_messages else protocol.feed(data)
        bad = [each for each in found if isinstance(each, BadLine)]
        self._sink.dropped_bytes += sum(each.size for each in bad)
        return [each for each in found if not isinstance(each, BadLine)], bad, arrival_s

    def _say(self, bad: BadLine) -> None:
        """Log each kind of flaw once; the others only count as dropped bytes."""
        if self._is_new(bad.flaw):
            self._log.warning("a line is left out", cause=bad.flaw.value, line=_line(bad))

    def _unfit(self, bad: Sequence[BadLine]) -> TransportError | ProtocolError:
        """Return the error for missing valid lines."""
        if bad:
            flaw = Counter(each.flaw for each in bad).most_common(1)[0][0]
            worst = [each for each in bad if each.flaw is flaw][-1]
            advice = ""
            if flaw is Flaw.NOT_TEXT and self._settings.port is not None:
                advice = f"; does the device use baud_rate = {self._settings.baud_rate}?"
            message = f"{self._where}: {_line(worst)}{advice}"
            return ProtocolError(ProtocolReason.UNSUPPORTED, message)
        if self._came_bytes:
            message = (
                f"{self._where}: {self._came_bytes} bytes came without a line end; check "
                "baud_rate and format, and whether the device ends its lines"
            )
            return ProtocolError(ProtocolReason.UNSUPPORTED, message)
        advice = "is the device sending, and to this computer?"
        if self._settings.openearable_sensor:
            advice = f"switch {self._settings.openearable_sensor} on in the app"
        message = f"{self._where}: nothing arrived for {self._wait_s:.0f} s; {advice}"
        return TransportError(TransportReason.ABSENT, message)


def row_protocol(settings: LineSettings) -> RowProtocol:
    """Return the protocol for a device with these settings."""
    columns = settings.parsed_columns
    positions = (settings.position(each) for each in settings.apart)
    needed = [each for each in positions if each is not None]
    if settings.format == "struct":
        start = bytes.fromhex(settings.frame_start)
        return FrameProtocol(checked_format(settings.struct_format), start, settings.checksum)
    reader = (
        JsonReader(columns, needed)
        if settings.format == "json"
        else CsvReader([each.label for each in columns], settings.separator, needed)
    )
    return LineProtocol(reader, skips_first=settings.port is not None)


def _line(bad: BadLine) -> str:
    """Return a clause that quotes the line and says what is wrong with it."""
    shown = bad.raw.decode("ascii") if bad.raw.isascii() else bad.raw.hex(" ")
    if bad.flaw in (Flaw.NO_FRAME, Flaw.CHECKSUM):
        shown = bad.raw.hex(" ")
    return f"the line {shown!a} {bad.why}"


def _where(settings: LineSettings) -> str:
    if settings.udp_port is not None:
        return f"UDP port {settings.udp_port}"
    return settings.url or settings.port or ""


def _make(settings: DeviceSettings, sink: DeviceSink) -> Callable[[], LineDriver]:
    """Share one emitter between all connections, to follow the count across them."""
    own = own_settings(LineSettings, settings)
    emitter = LineEmitter(own, sink)
    return lambda: LineDriver(own, sink, emitter)


def _declare(settings: DeviceSettings) -> SensorSpec:
    return own_settings(LineSettings, settings).spec


def _texts(key: str, behind: str = "") -> tuple[re.Pattern[bytes], ...]:
    """Return patterns of the texts behind a key of JSON; short ones with their quotation marks."""
    text = r'(?:[^"\\]|\\.)'
    return (
        re.compile(rf'{key}\s*:\s*"({text}{{4,}})"{behind}'.encode()),
        re.compile(rf'{key}\s*:\s*("{text}{{2,3}}"){behind}'.encode()),
    )


_WORDS_OF_THE_APP = "method|action|stream|event|sensor_id|type|name"
_NO_SENSOR = '(?:(?!"sensor_id")[^{}])*'
IDENTIFIERS = (
    re.compile(rb'"(?:device_id|serial_number|serial|mac)"\s*:\s*"([^"]{4,})"'),
    *_texts(rf'"(?!(?:{_WORDS_OF_THE_APP})")\w+"(?!\s*:\s*"-?[0-9.]+")'),
    # The sensor is asked for by its name; other names, as the wearable's, are often a person's.
    *_texts(rf'[{{}}]{_NO_SENSOR}?"name"', r'(?![^{}]*"sensor_id")'),
    # Places on earth: in JSON, and as GPS receivers write them.
    re.compile(rb'"(?:lat|lon|lng|latitude|longitude)"\s*:\s*"?(-?[0-9]{1,3}\.[0-9]{3,})', re.I),
    re.compile(rb"\b([0-9]{4,5}\.[0-9]{2,}),[NSEW]\b"),
)
"""All texts of JSON but numbers and the words by which the OpenEarable app is asked; positions."""
FORMS = frozenset(
    {"sequence_column", "time_column", "struct_format", "frame_start", "openearable_sensor"}
)
DRIVER = DriverEntry(LineSettings, _make, declare=_declare, identifiers=IDENTIFIERS, forms=FORMS)


class _UdpLink:
    """Receives datagrams on a UDP port; each read is a complete datagram."""

    def __init__(self, port: int) -> None:
        self._port = port
        self._udp: UdpPort | None = None
        self._incoming: asyncio.Queue[Received | TransportError] = asyncio.Queue()

    async def open(self) -> None:
        """Start listening.

        Raises
        ------
        TransportError
            ``BUSY``, ``DENIED`` or ``UNAVAILABLE``.
        """
        try:
            self._udp = UdpPort(port=self._port)
        except OSError as error:
            raise self._refusal(error) from error
        self._udp.listen(self._take, self._lost)

    async def read(self) -> Received:
        """Wait for the next datagram; raise ``LOST`` when the port is closed."""
        item = await self._incoming.get()
        if isinstance(item, TransportError):
            self._incoming.put_nowait(item)
            raise item
        return item

    def write(self, data: bytes) -> None:
        """Do nothing, because the receiver is unknown."""

    async def close(self) -> None:
        """Stop listening."""
        if self._udp is not None:
            await self._udp.close()

    def _refusal(self, error: OSError) -> TransportError:
        name = f"UDP port {self._port}"
        if error.errno == errno.EADDRINUSE:
            advice = "another program or device uses it; choose another number for both"
            return TransportError(TransportReason.BUSY, f"{name}: {advice}")
        if error.errno in (errno.EACCES, errno.EPERM):
            advice = "the system reserves it; choose a number above 1023"
            return TransportError(TransportReason.DENIED, f"{name}: {advice}")
        message = f"{name}: it is not available ({error.strerror or error})"
        return TransportError(TransportReason.UNAVAILABLE, message)

    def _take(self, data: bytes, arrival_s: float, sender: Address) -> None:
        del sender
        self._incoming.put_nowait(Received(data, arrival_s))

    def _lost(self, cause: OSError) -> None:
        message = f"UDP port {self._port}: the link was cut; is the network still there?"
        error = TransportError(TransportReason.LOST, message)
        error.__cause__ = cause
        self._incoming.put_nowait(error)


class LineLink(Protocol):
    """Source of lines."""

    in_messages: bool  # Whether each read ends with a line.

    async def open(self) -> None:
        """Open it; raises TransportError, or ConfigError for an invalid address."""
        ...

    async def read(self) -> Received:
        """Wait for the next bytes; raise TransportError ``LOST`` at its end."""
        ...

    async def send(self, text: str) -> None:
        """Send a command."""
        ...

    async def close(self) -> None:
        """Close it; never raises."""
        ...


def line_link(settings: LineSettings) -> LineLink:
    """Return the link in the settings, still closed."""
    if settings.udp_port is not None:
        return _Bytes(byte_link_of(_UdpLink(settings.udp_port)), in_messages=True)
    if settings.url is not None and settings.openearable_sensor:
        time_unit = settings.parsed_columns[0].unit
        asked = Asked(settings.openearable_sensor, settings.openearable_wearable, time_unit)
        return OpenEarableLink(settings.url, asked)
    if settings.url is not None:
        return _WebSocket(settings.url)
    assert settings.port is not None
    return _Bytes(byte_link(settings.port, settings.baud_rate), in_messages=False)


class _Bytes:
    """A serial port, a TCP connection or datagrams."""

    def __init__(self, link: ByteLink, *, in_messages: bool) -> None:
        self._link, self.in_messages = link, in_messages
        self.open = link.open
        self.read = link.read
        self.close = link.close

    async def send(self, text: str) -> None:
        self._link.write(text.encode())


class _WebSocket:
    """Text messages over a WebSocket."""

    in_messages = True

    def __init__(self, url: str) -> None:
        self._link = text_link_of(WebSocketLink(url))
        self.open = self._link.open
        self.send = self._link.send
        self.close = self._link.close

    async def read(self) -> Received:
        text, arrival_s = await self._link.read()
        return Received(text.encode("utf-8", "surrogatepass"), arrival_s)
