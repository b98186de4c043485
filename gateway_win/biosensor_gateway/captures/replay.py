"""Runs a capture through the driver of its sensor, and reports the outcome."""

from __future__ import annotations

import asyncio
import os
from collections import Counter
from collections.abc import Callable, Generator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from statistics import median
from typing import Any, get_args

import pylsl
from numpy.typing import ArrayLike
from pydantic import ValidationError

from biosensor_common.errors import ConfigError, ConfigReason
from biosensor_common.lsl.api_file import LslOverrides
from biosensor_common.lsl.network import configure_lsl
from biosensor_common.naming import source_id
from biosensor_common.spec import DeviceIdentity, DeviceInfo, SensorSpec
from biosensor_gateway.agent.supervisor import Supervisor
from biosensor_gateway.captures.bluetooth import backends
from biosensor_gateway.captures.file import Advertised, Arrivals, Capture
from biosensor_gateway.captures.link_player import Player, ReplayedLink, ReplayedPorts
from biosensor_gateway.devices.registry import declared, driver
from biosensor_gateway.settings.models import DeviceSettings
from biosensor_gateway.simulation.bleak_pickers import standing_in
from biosensor_gateway.streaming.outlets import DeviceOutlets, Nowhere, Outlet
from biosensor_gateway.streaming.sink import DeviceSink
from biosensor_gateway.system.clock import LSL_CLOCK, Clock, LeapingClock
from biosensor_gateway.transports.tap import Replacement, What, replaced

SETTLING_S = 0.5
"""Time after the last byte, in which the driver emits its last samples."""
BEGIN_S = 1000.0
"""Start of the virtual clock, so that stamps before it are not negative."""
GIVE_UP_S = 60.0
"""A driver that does not open the next connection within this time has given up."""
UNIT = "replayed"
URL = "ws://replayed:1"
_NOTHING_SEEN = Advertised(address="00:00:00:00:00:00")
_PLACES = frozenset({"device", "headset", "port", "host", "url", "ca_file"})
"""Settings with the place of a device, which a capture does not need."""
_FILLED = {"port": UNIT, "host": UNIT, "url": URL}
"""Values for places without which a driver would make no link, or would search."""


@dataclass(slots=True)
class StreamReport:
    """Outcome of one stream."""

    samples: int = 0
    # lost, refused: samples lost by the device's counters, and samples that were refused.
    lost: int = 0
    refused: int = 0
    # Time from the stamp of each packet's last sample to its arrival [s].
    ages_s: list[float] = field(default_factory=list[float])

    @property
    def least_s(self) -> float | None:
        """Smallest age; negative if a stamp is later than the arrival."""
        return min(self.ages_s, default=None)

    @property
    def median_s(self) -> float | None:
        """Median age."""
        return median(self.ages_s) if self.ages_s else None

    @property
    def most_s(self) -> float | None:
        """Largest age."""
        return max(self.ages_s, default=None)


@dataclass(slots=True)
class Report:
    """Outcome of the replay of a capture."""

    info: DeviceInfo | None = None
    connections: int = 0
    seconds: float = 0.0
    # Streams with samples or losses, by data name.
    streams: dict[str, StreamReport] = field(default_factory=dict[str, StreamReport])
    dropped_bytes: int = 0  # Bytes that were not part of a valid message.
    reanchors: int = 0
    # What was not passed on unchanged, in the agent's words.
    sentences: list[str] = field(default_factory=list[str])
    # Why the replay differs from the capture; empty if it does not.
    problems: list[str] = field(default_factory=list[str])
    notes: list[str] = field(default_factory=list[str])  # Other information.


class UnsentOutlet(Outlet):
    """Checks and counts samples as an outlet does, and sends nothing."""

    def _made(self, info: pylsl.StreamInfo) -> Nowhere:
        del info
        return Nowhere()


class ReplaySink(DeviceSink):
    """Takes a driver's samples, and compares stamps with arrivals.

    Parameters
    ----------
    kind
        Class of the outlets; `Outlet` for a live replay.
    """

    def __init__(
        self,
        identity: DeviceIdentity,
        spec: SensorSpec,
        clock: Clock,
        kind: type[Outlet] = UnsentOutlet,
    ) -> None:
        super().__init__(identity, spec, clock)
        self._outlets = DeviceOutlets(identity, spec, clock, kind)
        self.tap = self._note
        self.noted: dict[str, StreamReport] = {}

    def _note(self, data_name: str, samples: ArrayLike, stamps: Sequence[float]) -> None:
        del samples
        noted = self.noted.setdefault(data_name, StreamReport())
        noted.samples += len(stamps)
        noted.ages_s.append(self.clock() - stamps[-1])


MakeSink = Callable[[DeviceIdentity, SensorSpec, Clock], ReplaySink]


def replay(
    capture: Capture,
    *,
    live: bool = False,
    make_sink: MakeSink | None = None,
) -> Report:
    """Run a capture through the driver of its sensor, on links that play it.

    Parameters
    ----------
    live
        Replay in real time, with LSL streams; otherwise as fast as possible, without streams.
    make_sink
        Makes the sink of the samples; by default, one that checks and counts them.

    Raises
    ------
    ConfigError
        ``MALFORMED`` if a link has no opening; ``WRONG_VALUE`` if the settings are invalid.
    SpecError
        If the sensor is unknown.
    """
    kind = Outlet if live else UnsentOutlet
    if not capture.events or any(link[0].what is not What.OPENED for link in capture.of_links()):
        message = "the capture has a connection without a start; have it recorded again"
        raise ConfigError(ConfigReason.MALFORMED, message)
    clock = LSL_CLOCK if live else LeapingClock(BEGIN_S)
    make = make_sink or partial(ReplaySink, kind=kind)
    with asyncio.Runner(loop_factory=clock.new_event_loop) as runner:
        return runner.run(_replayed(capture, clock, make))


def live_outlets(lsl: LslOverrides) -> None:
    """Configure LSL for live replays; to be called before any other use of LSL."""
    configure_lsl(lsl)


def replay_settings(capture: Capture) -> DeviceSettings:
    """Return settings with which a driver connects to a capture's device.

    Raises
    ------
    ConfigError
        ``WRONG_VALUE`` if the capture's settings are invalid or incomplete.
    """
    header, seen = capture.header, capture.events[0].seen
    model = driver(header.sensor).settings
    fields: dict[str, Any] = {"sensor": header.sensor, "unit": UNIT, **header.settings}
    for name, field_info in model.model_fields.items():
        # The place of the device, which a capture does not have.
        is_place = field_info.is_required() or (
            name in header.left_out and name in _FILLED and not field_info.default
        )
        kinds = (field_info.annotation, *get_args(field_info.annotation))
        if name not in fields and is_place and str in kinds:
            fields[name] = _FILLED.get(name, UNIT)
    if "device" in model.model_fields:
        fields["device"] = "" if seen is None else seen.address
    try:
        return model.model_validate(fields)
    except ValidationError as error:
        first = error.errors()[0]
        what = f"{'.'.join(map(str, first['loc']))}: {first['msg']}"
        message = f"the settings of the capture are not valid for {header.sensor} ({what})"
        raise ConfigError(ConfigReason.WRONG_VALUE, message) from error


async def _replayed(capture: Capture, clock: Clock, make_sink: MakeSink) -> Report:
    settings = replay_settings(capture)
    player = Player(capture, clock)
    sink = make_sink(settings.identity, declared(settings), clock)
    with _links(capture, player, clock):
        supervisor = Supervisor(driver(settings.sensor).make(settings, sink), sink)
        running = asyncio.create_task(supervisor.run())
        begun_s = clock()
        is_played = await _play(player, clock)
        report = _report(sink, player, supervisor, capture.header.left_out)
        if capture.header.arrivals is Arrivals.UNKNOWN:
            for stream in report.streams.values():
                stream.ages_s.clear()
            report.notes.append(
                "its time of arrival is not known, so its timestamps cannot be judged"
            )
        report.seconds = clock() - begun_s
        if not is_played:
            report.problems.append(
                f"the driver made {len(player.links)} connections of {len(capture.of_links())}: "
                f"{supervisor.last_error or 'it gives no reason'}"
            )
        running.cancel()
        await asyncio.gather(running, return_exceptions=True)
        sink.close()
    return report


@contextmanager
def _links(capture: Capture, player: Player, clock: Clock) -> Generator[None]:
    seen = capture.events[0].seen
    instead = Replacement(lambda: ReplayedLink(player, clock), lambda: ReplayedPorts(player, clock))
    # Also without an advertisement: else the driver would use this computer's radio.
    radio = standing_in(backends(player, seen or _NOTHING_SEEN))
    with replaced(instead), _signed_in(capture.header.sensor), radio:
        yield


@contextmanager
def _signed_in(sensor: str) -> Generator[None]:
    """Provide dummy secrets to the driver, because a capture accepts any."""
    missing = [each.variable for each in driver(sensor).secrets if each.variable not in os.environ]
    os.environ.update(dict.fromkeys(missing, UNIT))
    try:
        yield
    finally:
        for each in missing:
            del os.environ[each]


async def _play(player: Player, clock: Clock) -> bool:
    """Wait until everything is played; return False if the driver gives up before."""
    playing = asyncio.create_task(player.played())
    known, since_s = -1, clock()
    while not playing.done():
        await asyncio.wait({playing}, timeout=1.0)
        is_waiting = not player.links or player.links[-1].is_over.is_set()
        if len(player.links) != known or not is_waiting or player.rest_s:
            known, since_s = len(player.links), clock()
        elif clock() - since_s > GIVE_UP_S:
            playing.cancel()
            return False
    await asyncio.sleep(SETTLING_S)
    return True


def _report(
    sink: ReplaySink, player: Player, supervisor: Supervisor, left_out: Sequence[str]
) -> Report:
    sink.release()
    report = Report(
        info=sink.info if sink.is_open else None,
        connections=supervisor.connections,
        dropped_bytes=sink.dropped_bytes,
        reanchors=sink.clock_state.reanchors,
    )
    for name in [each.data_name for each in sink.spec.streams if sink.is_open]:
        source = source_id(sink.identity, name)
        counters, stream = sink.counters[source], sink.noted.get(name, StreamReport())
        stream.lost, stream.refused = counters.lost, counters.refused
        if stream.samples or stream.lost or stream.refused:
            report.streams[name] = stream
        report.sentences += [f"{name}: {each.sentence}" for each in sink.refused[source].all]
    report.sentences += [each.sentence for each in sink.refusals.all]
    if supervisor.last_error is not None:
        report.problems.append(supervisor.last_error)
    if not report.streams:
        report.problems.append("no sample was decoded")
    unknown, unasked = Counter[tuple[str, str]](), Counter[tuple[str, str]]()
    for link in player.links:
        unknown += link.unknown
        unasked += link.unasked
    report.notes += [
        f"the driver sent {count} requests to which the capture has no answer: {what} {at}".rstrip()
        for (what, at), count in unknown.items()
    ]
    report.notes += [
        f"the driver did not send {count} requests that the device got then: {what} {at}".rstrip()
        for (what, at), count in unasked.items()
    ]
    if set(left_out) - _PLACES:
        names = ", ".join(sorted(set(left_out) - _PLACES))
        report.notes.append(
            f"it was captured with other settings, which are not in the file: {names}"
        )
    if player.unheard:
        report.notes.append(f"{player.unheard} packets came that the driver did not listen for")
    return report
