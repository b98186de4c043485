"""Captures a device, to improve its driver; the contents are shown before they are saved."""

from __future__ import annotations

import asyncio
from typing import Literal

from fastapi import APIRouter
from pydantic import BaseModel, Field

from biosensor_common.errors import ConfigError, ConfigReason, TransportError, TransportReason
from biosensor_gateway.agent.control import stop_agent
from biosensor_gateway.captures.draft import (
    AGREED,
    CONSENT,
    HOW_TO_SEND,
    MOST_NOTE,
    SECONDS,
    CaptureDesk,
    Phase,
)
from biosensor_gateway.devices.registry import sensor_title
from biosensor_gateway.page.models import Body, Choice, Outcome
from biosensor_gateway.page.routes.api import QuestionError
from biosensor_gateway.page.routes.devices import started
from biosensor_gateway.page.routes.replay import whole_path
from biosensor_gateway.page.routes.search import settings_of
from biosensor_gateway.page.session import Session
from biosensor_gateway.recording.recorder.state import file_going_on
from biosensor_gateway.settings.models import DeviceSettings
from biosensor_gateway.settings.places import usual_recordings_folder


class NewCapture(Body):
    """The device to capture: by its unit in the settings, or by new settings for a found device.

    Attributes
    ----------
    unit
        Empty for a device that is not in the settings.
    settings
        Fields of such a device, as its table in the settings would have them.
    end_agent
        Whether the agent may be ended if it has the device; it is started again afterwards.
    """

    sensor: str
    unit: str = ""
    settings: dict[str, str | int | float | bool] = Field(default_factory=dict)
    seconds: float = Field(SECONDS, ge=5, le=3600)
    end_agent: bool = False


class Agreement(Body):
    """The wearer's consent to what `CaptureView.consent` says.

    Attributes
    ----------
    folder
        Folder of the file.
    note
        Observations, without names.
    """

    agreed: Literal[True]
    folder: str
    note: str = Field("", max_length=MOST_NOTE)


class ConfiguredDevice(BaseModel):
    """A device of the settings that could be captured."""

    sensor: str
    unit: str
    title: str


class CaptureView(BaseModel):
    """Progress of a capture, and the contents of its file.

    Attributes
    ----------
    title
        Name of the sensor for people; empty without a capture.
    elapsed_s, seconds
        Time since the device was connected, and total time from then on.
    packets
        Number of packets from the device.
    problem
        Why the capture failed: a sentence.
    lines
        Summary of the file and of what was replaced in it; some are indented.
    problems
        Problems of the device that the driver found.
    consent, agreed
        Information for the wearer, and the text of their consent.
    folder
        Default folder of the file.
    """

    phase: Phase
    title: str
    elapsed_s: float
    seconds: float
    packets: int
    problem: str
    lines: list[str]
    problems: list[str]
    devices: list[ConfiguredDevice]
    consent: str = CONSENT
    agreed: str = AGREED
    folder: str


class Capturing:
    """Captures one device at a time, and ends the agent during this time if it has the device."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self._desk = CaptureDesk()
        self._folder = usual_recordings_folder()
        self._returning: asyncio.Task[None] | None = None

    async def run(self) -> None:
        """Wait until cancelled; then give the agent its device back."""
        try:
            await asyncio.Event().wait()
        finally:
            await self.discard()

    def view(self) -> CaptureView:
        """Return the progress, and the contents of the file."""
        progress, draft = self._desk.progress, self._desk.draft
        configured = self._session.configured()
        return CaptureView(
            phase=progress.phase,
            title=sensor_title(progress.sensor) if progress.sensor else "",
            elapsed_s=progress.elapsed_s,
            seconds=progress.seconds,
            packets=progress.packets,
            problem=progress.problem,
            lines=draft.lines if draft else [],
            problems=draft.problems if draft else [],
            devices=[
                ConfiguredDevice(
                    sensor=each.sensor, unit=each.unit, title=sensor_title(each.sensor)
                )
                for each in configured
            ],
            folder=str(self._folder),
        )

    def whole(self) -> list[str]:
        """Return each line of the file as it would be saved.

        Raises
        ------
        ConfigError
            ``NOT_FOUND`` if nothing was captured.
        """
        if self._desk.draft is None:
            raise ConfigError(ConfigReason.NOT_FOUND, "there is no capture to show; start one")
        return list(self._desk.draft.whole())

    async def start(self, wanted: NewCapture) -> Outcome:
        """Begin to capture.

        Raises
        ------
        ConfigError
            ``WRONG_VALUE`` or ``NOT_FOUND``: there is no such device; ``IN_USE``: another is being
            captured, or a recording needs the agent; a `QuestionError` if it must end first.
        SpecError
            If the sensor is unknown.
        """
        if self._desk.progress.phase in {Phase.CONNECTING, Phase.CAPTURING}:
            message = "a device is being captured; wait until that ends, or end it"
            raise ConfigError(ConfigReason.IN_USE, message)
        settings = self._settings(wanted)
        was_taken = await self._take_from_agent(settings, wanted)
        self._desk.start(settings, wanted.seconds)
        if was_taken:
            self._returning = asyncio.create_task(self._return_to_agent())
        title = sensor_title(settings.sensor)
        return Outcome(sentence=f"{title}: connecting, then {wanted.seconds:g} s are captured.")

    def save(self, agreement: Agreement) -> Outcome:
        """Write the file.

        Raises
        ------
        ConfigError
            If there is nothing to save, or the file cannot be written.
        """
        folder = whole_path(agreement.folder)
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            message = f"{folder} cannot be made ({error.strerror}); choose another folder"
            raise ConfigError(ConfigReason.UNREADABLE, message) from error
        file = self._desk.save(folder, agreement.note)
        self._folder = folder
        size_kb = file.stat().st_size / 1024
        said = f"Saved: {file} ({size_kb:.0f} KB). Nothing was sent. {HOW_TO_SEND}"
        return Outcome(sentence=said)

    async def discard(self) -> None:
        """End a running capture, and discard its data."""
        await self._desk.discard()
        if self._returning is not None:
            await asyncio.wait([self._returning])

    def _settings(self, wanted: NewCapture) -> DeviceSettings:
        if not wanted.unit:
            return settings_of(wanted.sensor, wanted.settings)
        which = wanted.sensor, wanted.unit
        for each in self._session.configured():
            if (each.sensor, each.unit) == which:
                return each
        message = f"there is no {wanted.sensor} {wanted.unit} in the settings; choose another"
        raise ConfigError(ConfigReason.NOT_FOUND, message)

    async def _take_from_agent(self, settings: DeviceSettings, wanted: NewCapture) -> bool:
        """End the agent if it has the device, because most devices accept one connection only."""
        if (settings.sensor_name, settings.unit) not in self._session.streamed():
            return False
        if file_going_on(self._session.folder) is not None:
            message = (
                "a recording is running, and the agent is using this device; capture it afterwards"
            )
            raise ConfigError(ConfigReason.IN_USE, message)
        if not wanted.end_agent:
            words = "End the agent, capture, and start it again"
            raise QuestionError(
                "The agent is using this device",
                "Most devices accept only one connection, so the agent must disconnect. All "
                f"streams end; after about {wanted.seconds:.0f} s they start again.",
                [Choice(words=words, more={"end_agent": True})],
            )
        try:
            await asyncio.to_thread(stop_agent, self._session.folder)
        except TransportError as error:
            if error.reason is not TransportReason.ABSENT:
                raise
        return True

    async def _return_to_agent(self) -> None:
        await self._desk.ended()
        try:
            started(self._session, virtual=False)
        except TransportError as error:
            # Another person or program has started it meanwhile.
            if error.reason is not TransportReason.BUSY:
                raise


def add_capture(router: APIRouter, capturing: Capturing) -> None:
    """Add the routes of captures."""

    @router.get("/capture")
    async def state() -> CaptureView:
        """Return the progress of the capture, and the contents of its file."""
        return capturing.view()

    @router.post("/capture")
    async def start(wanted: NewCapture) -> Outcome:
        """Capture the traffic between a device and its driver; nothing is saved yet."""
        return await capturing.start(wanted)

    @router.get("/capture/whole")
    async def whole() -> list[str]:
        """Show each line of the file as it would be saved."""
        return await asyncio.to_thread(capturing.whole)

    @router.post("/capture/save")
    async def save(agreement: Agreement) -> Outcome:
        """Write the file, with the wearer's consent; nothing is sent."""
        return await asyncio.to_thread(capturing.save, agreement)

    @router.delete("/capture")
    async def discard() -> Outcome:
        """End a running capture, and discard its data."""
        await capturing.discard()
        return Outcome(sentence="Nothing was saved.")
