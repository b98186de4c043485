"""Agent and node on computers of a network, with those who watch what they do."""

from __future__ import annotations

import json
import time
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack
from pathlib import Path
from types import TracebackType
from typing import NamedTuple, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from biosensor_common import naming
from biosensor_common.spec import DeviceIdentity
from biosensor_gateway.demo.virtual_devices import one_of_each
from biosensor_gateway.devices.registry import declaration
from lsl_to_ros.statistics.losses import GAP_PERIODS
from tests.rigs.hosts import completeness
from tests.rigs.hosts.completeness import MARGIN_S, Recording, Span, fault, is_current
from tests.rigs.hosts.lan import Host, Lan
from tests.rigs.hosts.programs import Program, SteeredProgram

SENSORS = one_of_each()
# Of the slowest stream, at 4 Hz, one fills in four seconds.
CHUNK_LENGTH = 16
# So long before a time the samples of its first chunk may begin, and come.
_CHUNK_S = 6.0
MATCH_TIMEOUT_S = 60.0
VIRTUAL_UNIT = "virtual"
_GATEWAY, _COUNTERS = "gateway", "counters"


class Place(NamedTuple):
    """Where one stream goes; *chunks* is empty if it has no chunk topic."""

    topic: str
    chunks: str
    is_state: bool = False

    @property
    def topics(self) -> list[str]:
        """Those that it has."""
        return [topic for topic in (self.topic, self.chunks) if topic]


class Places(NamedTuple):
    """On which computer each program runs; the receiver is the LSL reference."""

    agent: str
    node: str
    subscriber: str
    receiver: str


def expected_places(agent_host: str, sensors: Sequence[str] = SENSORS) -> dict[str, Place]:
    """All streams of an agent with a virtual device of each of these kinds, by source_id."""
    identities = [DeviceIdentity(name, VIRTUAL_UNIT) for name in sensors]
    places = {
        naming.source_id(identity, stream.data_name): Place(
            _topic(identity, stream.data_name),
            f"{_topic(identity, stream.chunk)}_chunk" if stream.chunk else "",
            stream.is_state,
        )
        for identity in identities
        for stream in declaration(identity.sensor).streams
    }
    gateway = DeviceIdentity(_GATEWAY, agent_host)
    return places | {
        naming.source_id(gateway, stream.data_name): Place(_topic(gateway, stream.data_name), "")
        for stream in declaration(_GATEWAY).streams
    }


def _topic(identity: DeviceIdentity, data_name: str) -> str:
    return f"/{naming.topic(identity, data_name)}"


class Observation(NamedTuple):
    """What the watchers have received."""

    streams: dict[str, Recording]  # By source_id, as LSL carried them.
    topics: dict[str, Recording]  # By name, as the subscriber got them.
    # Unix time and, by topic, the facts of its status.
    diagnostics: list[tuple[float, dict[str, dict[str, str]]]]

    def facts_at(self, time_s: float) -> dict[str, dict[str, str]]:
        """Return the first diagnostics that came from a time on."""
        return next(facts for came, facts in self.diagnostics if came >= time_s)

    def faults(
        self, places: Mapping[str, Place], required: Span, calm: Sequence[Span]
    ) -> dict[str, str]:
        """Say by topic what is wrong with what the subscriber got; see `completeness.fault`."""
        found: dict[str, str] = {}
        for source, place in places.items():
            for topic, unfilled in ((place.topic, 0), (place.chunks, CHUNK_LENGTH - 1)):
                reference = self.streams[source]
                if topic and (
                    what := fault(reference, self.topics[topic], required, calm, unfilled)
                ):
                    # No chunk spans a gap, so this tells whose fault it is.
                    step_s = float(self._steps_s(source, required).max(initial=0.0))
                    found[topic] = f"{what}; the longest step of its stamps is {step_s:.3f} s"
        return found

    def faults_in_bad_weather(
        self, places: Mapping[str, Place], required: Span, calm: Sequence[Span]
    ) -> dict[str, str]:
        """Say the same of a time in which the network was disturbed.

        A latched topic keeps one message, so of a state only the newest counts. On a busy
        machine a virtual device may lose samples; no chunk spans such a gap.
        """
        states = {s: place for s, place in places.items() if place.is_state}
        steady = {source: place for source, place in places.items() if source not in states}
        outdated = {
            place.topic: "the newest state did not come"
            for source, place in states.items()
            if not is_current(self.streams[source], self.topics[place.topic], required)
        }
        whole = {
            source: place._replace(chunks="")
            if place.chunks and self._has_gap(source, required)
            else place
            for source, place in steady.items()
        }
        return self.faults(whole, required, calm) | outdated

    def _has_gap(self, source: str, span: Span) -> bool:
        steps_s = self._steps_s(source, span)
        return len(steps_s) > 0 and bool(steps_s.max() > GAP_PERIODS * np.median(steps_s))

    def _steps_s(self, source: str, span: Span) -> NDArray[np.float64]:
        around = self.streams[source].between(span.start - _CHUNK_S, span.end + MARGIN_S)
        return np.diff(around.stamps)

    @property
    def counters(self) -> Recording:
        """What the agent said of its streams."""
        return next(
            stream
            for source, stream in self.streams.items()
            if source.startswith(_GATEWAY) and source.endswith(_COUNTERS)
        )


class Talking(Protocol):
    """A running program, as far as one needs it to tell why something is missing."""

    @property
    def last_words(self) -> str:
        """The end of what it wrote."""
        ...


class Pair:
    """The running programs; a context manager.

    Parameters
    ----------
    environment
        Of all programs; each computer gets a folder of state of its own.
    best_effort
        Topic that the subscriber receives a second time, best effort.
    agent
        Started last, in place of an agent of this project's own interpreter.
    sensors
        Of which the agent has a virtual device each.
    """

    def __init__(
        self,
        lan: Lan,
        places: Places,
        environment: Mapping[str, str],
        folder: Path,
        best_effort: str = "",
        agent: AbstractContextManager[Talking] | None = None,
        sensors: Sequence[str] = SENSORS,
    ) -> None:
        self._lan, self._places = lan, places
        self._environment, self._folder = environment, folder
        self._best_effort = best_effort
        self._given_agent = agent
        self._stack = ExitStack()
        self._sensors = sensors
        self.expected = expected_places(places.agent, sensors)

    def __enter__(self) -> Self:
        places = self._places
        with ExitStack() as stack:
            self._receiver = stack.enter_context(
                SteeredProgram(*self._on(places.receiver), "tests.rigs.hosts.receiver")
            )
            self._subscriber = stack.enter_context(
                SteeredProgram(
                    *self._on(places.subscriber),
                    "tests.rigs.hosts.subscriber",
                    *(("--best-effort", self._best_effort) if self._best_effort else ()),
                )
            )
            chunks = ("--ros-args", "-p", f"Chunk_Length:={CHUNK_LENGTH}")
            self.node = stack.enter_context(
                Program(*self._on(places.node), "lsl_to_ros.node", *chunks)
            )
            self.agent = stack.enter_context(self._given_agent or self._simulating_agent())
            self._stack = stack.pop_all()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._stack.__exit__(kind, error, trace)

    def await_matched(self) -> None:
        """Wait until every stream is received and every topic has its reader, on both sides.

        Raises
        ------
        TimeoutError
            With what is missing.
        """
        end = time.monotonic() + MATCH_TIMEOUT_S
        while missing := self._unmatched():
            if time.monotonic() > end:
                said = f"{self.agent.last_words}\n{self.node.last_words}"
                raise TimeoutError(f"not matched: {missing}\n{said}")
            time.sleep(0.5)

    def observe(self) -> Observation:
        """Fetch what the watchers have received so far."""
        streams, topics = self._folder / "streams.npz", self._folder / "topics.npz"
        self._receiver.ask("save", path=str(streams))
        self._subscriber.ask("save", path=str(topics))
        diagnostics = json.loads(topics.with_suffix(".json").read_text())
        return Observation(
            completeness.load(streams),
            completeness.load(topics),
            [(came, facts) for came, facts in diagnostics],
        )

    def _simulating_agent(self) -> AbstractContextManager[Talking]:
        simulate = ("run", "--simulate", ",".join(self._sensors))
        return Program(*self._on(self._places.agent), "biosensor_gateway.cli", *simulate)

    def _on(self, name: str) -> tuple[Host, dict[str, str], Path]:
        state = {"BIOSENSOR_GATEWAY_STATE": str(self._folder / f"state-{name}")}
        return self._lan[name], {**self._environment, **state}, self._folder

    def _unmatched(self) -> list[str]:
        received = self._receiver.ask("state")
        state = self._subscriber.ask("state")
        matched, facts = set(state["matched"]), state["diagnostics"]
        missing: list[str] = []
        for source, place in self.expected.items():
            topics = place.topics
            readers = int(facts.get(place.topic, {}).get("subscribers", 0))
            if source not in received or readers < len(topics) or not matched.issuperset(topics):
                missing.append(source)
        return missing
