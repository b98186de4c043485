"""The API `/api/v1` of the page; its answers are in `models`."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from functools import partial

import pylsl
from fastapi import APIRouter

from biosensor_common.errors import ConfigError
from biosensor_common.lsl.api_file import LslOverrides
from biosensor_common.lsl.network import Living, Network, configure_lsl
from biosensor_common.lsl.predicates import any_of, equals
from biosensor_common.refusal import Refusal, Refusals
from biosensor_gateway.agent.status import RefusedStatus
from biosensor_gateway.features.outputs import READ_SPELLINGS, feature_streams
from biosensor_gateway.page.experiments.experiment_server import ExperimentServer
from biosensor_gateway.page.models import Problem, SeenStreamView
from biosensor_gateway.page.network.network_thread import Reader, into
from biosensor_gateway.page.routes.agent import add_agent, add_quit, add_secrets
from biosensor_gateway.page.routes.api import new_app
from biosensor_gateway.page.routes.capture import Capturing, add_capture
from biosensor_gateway.page.routes.devices import add_devices, worn_by
from biosensor_gateway.page.routes.doctor import NetworkAnswer, add_doctor
from biosensor_gateway.page.routes.files import add_files
from biosensor_gateway.page.routes.markers import Marking, add_markers
from biosensor_gateway.page.routes.recording import Recorder, add_recording
from biosensor_gateway.page.routes.replay import Replaying, add_replay
from biosensor_gateway.page.routes.search import add_search
from biosensor_gateway.page.session import Session, Shutdown
from biosensor_gateway.page.static_files import PREFIX

_LOOK_S = 0.25
_OF_ALL = "this agent"
_RAW_STREAMS = any_of(*(equals("type", each) for each in READ_SPELLINGS))


class Interface:
    """The application of the API: devices, recordings, markers, checks."""

    def __init__(self, session: Session, shutdown: Shutdown) -> None:
        self._session = session
        self._recorder = recorder = Recorder(session, partial(worn_by, session))
        self._marking = Marking(session)
        self._answer = NetworkAnswer(session.settings, session.folder)
        self._replaying = Replaying(session)
        self._capturing = Capturing(session)
        router = APIRouter(prefix=PREFIX, responses={400: {"model": Problem}})
        add_agent(router, session)
        add_quit(router, session, recorder, shutdown)
        add_search(router, session)
        add_devices(router, session)
        add_recording(router, recorder)
        add_markers(router, self._marking)
        add_secrets(router, session)
        add_doctor(router, session, self._answer)
        add_replay(router, recorder, self._replaying)
        add_files(router, session)
        add_capture(router, self._capturing)
        self.app = new_app()
        # `include_router` would build each route and its models once more.
        self.app.router.routes.extend(router.routes)

    async def run(self) -> None:
        """Watch the recording, markers, features and web experiments until cancelled."""
        await asyncio.gather(
            self._recorder.run(),
            self._marking.run(),
            self._answer.run(),
            self._replaying.run(),
            self._capturing.run(),
            ExperimentServer(self._session).run(),
            Features(self._session).run(),
        )


class Features:
    """Receives the features of the agent's streams while a browser shows them.

    Features have a few values per second, so that an inlet for each costs little. Raw streams come
    from the agent's feed instead.

    Parameters
    ----------
    session
        Has the agent's devices, and is given the features and their samples.
    """

    def __init__(self, session: Session) -> None:
        self._session = session
        self._wanted: frozenset[str] = frozenset()
        self._lsl_session = ""
        self._refusals = Refusals(clock=session.now)
        self._told: dict[str, str] = {}
        self._living = Living(_RAW_STREAMS)

    async def run(self) -> None:
        """Receive until cancelled."""
        # Not before an agent has come: liblsl reads its settings at its first call, and they must
        # be those with which the agent was started.
        await self._session.came.wait()
        # The settings may have changed since.
        self._lsl_session = self._session.lsl_session
        try:
            overrides = self._session.loaded().lsl.overrides
        except ConfigError:
            overrides = LslOverrides()
        try:
            configure_lsl(replace(overrides, session_id=self._lsl_session))
        except ConfigError as error:
            # Unconfigured, LSL would find those of its default session.
            self._tell({_OF_ALL: f"they are not shown: {error}"})
            return
        reader = await asyncio.to_thread(Reader, into(self._session.traces), feature_streams())
        raw = await asyncio.to_thread(Network, _RAW_STREAMS)
        try:
            while True:
                self._look(reader, raw)
                await asyncio.sleep(_LOOK_S)
        finally:
            await asyncio.to_thread(reader.stop)

    def _look(self, reader: Reader, raw: Network) -> None:
        agent, own = self._session.lsl_session, self._lsl_session
        found = [each for dev in reader.view.devices for each in dev.streams if each.derived_from]
        features, untold = list[SeenStreamView](), dict[str, str]()
        if agent == own:
            doubled = self._doubled(raw)
            features = [each for each in found if each.derived_from not in doubled]
            hidden = {each.derived_from for each in found} & doubled.keys()
            untold = dict(doubled[each] for each in hidden)
        elif agent:
            untold[_OF_ALL] = (
                f"they are not shown: the agent now sends in the LSL session {agent}, and this "
                f"page looks in {own}, where streams of the same name belong to other people; "
                "end the page and open it again"
            )
        self._tell(untold)
        self._session.features = features
        wanted = self._of_the_agent(features) if self._session.traces.screens else frozenset[str]()
        self._session.traces.history.forget(self._wanted - wanted)
        self._wanted = reader.wanted = wanted

    def _doubled(self, raw: Network) -> dict[str, tuple[str, str]]:
        """Return whose features may be another agent's: LSL name and reason, by source_id."""
        sources = self._session.sources()
        by_source: dict[str, list[pylsl.StreamInfo]] = {}
        for each in raw.streams():
            if each.source_id() in sources:
                by_source.setdefault(each.source_id(), []).append(each)
        doubted = [e.uid() for senders in by_source.values() if senders[1:] for e in senders]
        # An outlet that has ended is found for some seconds more beside its successor.
        alive = self._living.among(doubted, self._session.now())
        found: dict[str, tuple[str, str]] = {}
        for source, senders in by_source.items():
            hosts = sorted({each.hostname() for each in senders})
            if len(hosts) > 1 or len(alive & {each.uid() for each in senders}) > 1:
                why = (
                    f"they are not shown, because they may be another person's: {len(senders)} "
                    f"agents, on {' and '.join(hosts)}, send this stream under one source_id; "
                    "give each agent's sensors a different participant, or end one agent"
                )
                found[source] = senders[0].name(), why
        return found

    def _tell(self, untold: dict[str, str]) -> None:
        """Report features that are not shown, by their stream, with the reason."""
        for about in self._told.keys() - untold.keys():
            self._refusals.over(Refusal.NO_FEATURES, about)
        for about, why in untold.items():
            self._refusals.refuse(Refusal.NO_FEATURES, about=about, why=why)
        self._told = untold
        self._session.unshown = RefusedStatus.of(self._refusals)

    def _of_the_agent(self, features: list[SeenStreamView]) -> frozenset[str]:
        sources = self._session.sources()
        return frozenset(each.source_id for each in features if each.derived_from in sources)
