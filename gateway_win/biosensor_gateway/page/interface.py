"""The API `/api/v1` of the page; its answers are in `models`."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from functools import partial

from fastapi import APIRouter

from biosensor_common.errors import ConfigError
from biosensor_common.lsl.api_file import LslOverrides
from biosensor_common.lsl.network import configure_lsl
from biosensor_gateway.features.outputs import feature_streams
from biosensor_gateway.page.experiments.server import ExperimentServer
from biosensor_gateway.page.models import Problem, SeenStreamView
from biosensor_gateway.page.network.source import Reader, into
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
        except ConfigError:
            # Unconfigured, LSL would find those of its default session.
            return
        reader = await asyncio.to_thread(Reader, into(self._session.traces), feature_streams())
        try:
            while True:
                self._look(reader)
                await asyncio.sleep(_LOOK_S)
        finally:
            await asyncio.to_thread(reader.stop)

    def _look(self, reader: Reader) -> None:
        # An agent that was started again may be in another session, where this program is not.
        devices = reader.view.devices if self._session.lsl_session == self._lsl_session else ()
        features = [each for device in devices for each in device.streams if each.derived_from]
        self._session.features = features
        wanted = self._of_the_agent(features) if self._session.traces.screens else frozenset[str]()
        self._session.traces.history.forget(self._wanted - wanted)
        self._wanted = reader.wanted = wanted

    def _of_the_agent(self, features: list[SeenStreamView]) -> frozenset[str]:
        sources = self._session.sources()
        return frozenset(each.source_id for each in features if each.derived_from in sources)
