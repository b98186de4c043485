"""The second half of what is loaded while the server runs already: the interface."""

from __future__ import annotations

import asyncio
from functools import partial

from biosensor_gateway.page.api import add_api
from biosensor_gateway.page.devices import worn_by
from biosensor_gateway.page.experiments.server import ExperimentServer
from biosensor_gateway.page.features import Features
from biosensor_gateway.page.marking import Marking
from biosensor_gateway.page.network_answer import NetworkAnswer
from biosensor_gateway.page.new_app import new_app
from biosensor_gateway.page.quitting import add_quit
from biosensor_gateway.page.recorder import Recorder
from biosensor_gateway.page.replaying import Replaying
from biosensor_gateway.page.service import Service


class Steering:
    """Takes what a person or a script asks for: devices, recordings, markers, checks.

    Parameters
    ----------
    service
        What is shown, and the end of it.

    Attributes
    ----------
    app
        The application of the interface.
    """

    def __init__(self, service: Service) -> None:
        self._session = session = service.session
        self._recorder = Recorder(session, partial(worn_by, session))
        self._marking = Marking(session)
        self._answer = NetworkAnswer(session.settings, session.folder)
        self._replaying = Replaying(session)
        self.app = new_app()
        add_api(self.app, session, self._recorder, self._marking, self._answer, self._replaying)
        add_quit(self.app, session, self._recorder, service.shutdown)

    async def run(self) -> None:
        """Watch the recording, markers, features and web experiments until cancelled."""
        await asyncio.gather(
            self._recorder.run(),
            self._marking.run(),
            self._answer.run(),
            self._replaying.run(),
            ExperimentServer(self._session).run(),
            Features(self._session).run(),
        )
