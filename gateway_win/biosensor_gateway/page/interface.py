"""The API `/api/v1`: what the page can ask for; see `models` for what it answers."""

from __future__ import annotations

from fastapi import APIRouter, FastAPI

from biosensor_common.errors import ConfigError, ConfigReason
from biosensor_gateway.page.routes.secrets import Access, add_access
from biosensor_gateway.page.device_log import add_device_log
from biosensor_gateway.page.device_test import DeviceTester, add_device_test
from biosensor_gateway.page.routes.devices import add_devices, asked, started
from biosensor_gateway.page.doctor import Doctor, add_doctor
from biosensor_gateway.page.static_files import PREFIX
from biosensor_gateway.page.marker_models import MarkerButtons, MarkerNumber, NewMarker
from biosensor_gateway.page.routes.markers import Marking
from biosensor_gateway.page.models import (
    DeviceName,
    NewRecording,
    Outcome,
    Problem,
    SearchView,
    StatusView,
)
from biosensor_gateway.page.routes.doctor import NetworkAnswer, add_network_answer
from biosensor_gateway.page.network_check import NetworkCheck, add_network_check
from biosensor_gateway.page.routes.recording import Recorder
from biosensor_gateway.page.recordings import add_replay
from biosensor_gateway.page.routes.errors import add_refusals
from biosensor_gateway.page.routes.replay import Replaying
from biosensor_gateway.page.routes.search import Search
from biosensor_gateway.page.session import Session


def add_api(
    app: FastAPI,
    session: Session,
    recorder: Recorder,
    marking: Marking,
    answer: NetworkAnswer,
    replaying: Replaying,
) -> None:
    """Add everything under `/api/v1`, and how refusals are told."""
    router = APIRouter(prefix=PREFIX, responses={400: {"model": Problem}})
    _add_agent(router, session)
    _add_search(router, session)
    add_devices(router, session)
    _add_pauses(router, session)
    _add_recording(router, recorder)
    _add_markers(router, marking)
    add_device_test(router, DeviceTester(session.streamed))
    add_device_log(router, session.folder)
    add_access(router, Access(session.configured))
    add_doctor(router, Doctor(session.settings, session.folder))
    add_network_check(router, NetworkCheck(session.settings, session.folder))
    add_network_answer(router, answer)
    add_replay(router, recorder, replaying)
    app.include_router(router)
    add_refusals(app)


def _add_agent(router: APIRouter, session: Session) -> None:
    @router.get("/status")
    async def status() -> StatusView:
        """Say how the agent and its devices are."""
        return session.status()

    @router.post("/agent/start")
    async def start() -> Outcome:
        """Start the agent with the devices of the settings."""
        if not any(each.enabled for each in session.configured()):
            message = "the settings name no device yet; add one first"
            raise ConfigError(ConfigReason.WRONG_VALUE, message)
        return started(session, virtual=False)

    @router.post("/agent/try")
    async def start_virtual() -> Outcome:
        """Start the agent with virtual devices of every kind."""
        return started(session, virtual=True)

    @router.post("/agent/stop")
    async def stop() -> Outcome:
        """End the agent; every stream ends with it."""
        await asked(session, "stop", {})
        return Outcome(sentence="The agent has been told to end.")


def _add_search(router: APIRouter, session: Session) -> None:
    search = Search(session.configured)

    @router.get("/search")
    async def found() -> SearchView:
        """Say how far the search for devices is."""
        return search.view()

    @router.post("/search")
    async def look() -> SearchView:
        """Search for devices in reach."""
        search.start()
        return search.view()


def _add_pauses(router: APIRouter, session: Session) -> None:
    @router.post("/devices/pause")
    async def pause(device: DeviceName) -> Outcome:
        """Send nothing of a device from now on, until it is resumed."""
        return await _switched(session, "pause", device)

    @router.post("/devices/resume")
    async def resume(device: DeviceName) -> Outcome:
        """Send again what a device measures from now on."""
        return await _switched(session, "resume", device)


def _add_recording(router: APIRouter, recorder: Recorder) -> None:
    @router.post("/recording/start")
    async def start(recording: NewRecording) -> Outcome:
        """Begin to record all streams."""
        return await recorder.start(recording)

    @router.post("/recording/stop")
    async def stop() -> Outcome:
        """End the recording, and judge it."""
        return await recorder.stop()

    @router.post("/recording/salvage")
    async def salvage() -> Outcome:
        """Write what can be read of a recording that was cut off to a file beside it."""
        return await recorder.salvage()


def _add_markers(router: APIRouter, marking: Marking) -> None:
    @router.post("/markers")
    async def mark(marker: NewMarker) -> Outcome:
        """Send a marker, stamped with now."""
        return Outcome(sentence=await marking.mark(marker))

    @router.put("/markers/buttons")
    async def name_buttons(wanted: MarkerButtons) -> Outcome:
        """Name the buttons of markers in the settings."""
        return Outcome(sentence=await marking.name_buttons(wanted))

    @router.post("/markers/undo")
    async def undo(which: MarkerNumber) -> Outcome:
        """Say that a marker was a mistake; nothing is deleted."""
        await marking.undo(which.id)
        return Outcome(sentence="The marker is marked as a mistake; it stays in the recording.")


async def _switched(session: Session, command: str, device: DeviceName) -> Outcome:
    answer = await asked(session, command, {"device": f"{device.sensor}/{device.unit}"})
    problem = answer.get("problem")
    if problem and not answer.get("pending"):
        # It is done; only the next start of the agent does not know.
        return Outcome(sentence=f"Done, but it is not kept for the next start: {problem}.")
    return Outcome(sentence=f"The device is {command}d.")
