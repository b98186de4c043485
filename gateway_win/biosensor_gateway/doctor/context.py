"""Reads the settings and folders of the agent for all checks, and checks them."""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

from pydantic import ValidationError

from biosensor_common.doctor import check
from biosensor_common.doctor.check import Finding, Guide, error, note, ok, warning
from biosensor_common.errors import ConfigError, SpecError
from biosensor_gateway.agent import status_file
from biosensor_gateway.agent.single_instance import is_held
from biosensor_gateway.devices.registry import declared
from biosensor_gateway.settings.models import DeviceSettings, GatewaySettings, LslSettings

LAB_RECORDER_PORT = 22345

_NOTHING_STREAMS = "Without a device, the agent streams nothing."
_PIP = f"{sys.executable} -m pip install --force-reinstall"

GUIDE = Guide(
    program="the agent",
    package="biosensor_gateway",
    distribution="biosensor-gateway",
    install=f"in the folder of the project: {sys.executable} -m pip install .",
    install_pylsl=f"{_PIP} pylsl",
    libraries={name: f"{_PIP} {name}" for name in ("bleak", "numpy")},
    ask_itself="biosensor-gateway config lsl",
    ask_others="on LabRecorder's computer: biosensor-gateway config lsl --for two-pc --peer {peer}",
    correct_file="biosensor-gateway config lsl --force",
    edit="biosensor-gateway config edit",
    alone=(
        "run it alone: biosensor-gateway doctor --only {check}; if it fails again, report it with "
        "the output of: biosensor-gateway doctor --json"
    ),
)


@dataclass(frozen=True, slots=True)
class Context(check.Context):
    """The computer and the settings that are examined."""

    settings_path: Path  # The settings file, which need not exist.
    state_folder: Path
    devices: tuple[DeviceSettings, ...] = ()  # Devices of the file; empty if it cannot be read.
    keep_awake: bool = True
    problem: Exception | None = None
    lab_recorder_port: int = LAB_RECORDER_PORT
    guide: Guide = field(default=GUIDE, kw_only=True)

    @property
    def enabled(self) -> tuple[DeviceSettings, ...]:
        """The devices that the agent connects to."""
        return tuple(device for device in self.devices if device.enabled)

    @property
    def streams_to_open(self) -> int:
        """Number of streams that the agent will open, its own included; 0 if it runs already."""
        if not self.enabled or is_held(self.state_folder):
            return 0
        return 1 + sum(_streams(device) for device in self.enabled)

    @property
    def offered(self) -> frozenset[str]:
        """source_ids of the open streams of the running agent."""
        try:
            status = status_file.read_status(self.state_folder)
        except ConfigError:
            return frozenset()
        return frozenset(source for device in status["devices"] for source in device["streams"])


def read_context(
    settings_path: Path, state_folder: Path, lab_recorder_port: int = LAB_RECORDER_PORT
) -> Context:
    """Read the settings; their problem, if any, is stored for the check of the settings."""
    context = Context(settings_path, state_folder, lab_recorder_port=lab_recorder_port)
    try:
        # Imported here, because the models need all drivers with their libraries.
        from biosensor_gateway.devices.registry import settings_models
        from biosensor_gateway.settings.file import load_or_defaults

        loaded = load_or_defaults(settings_path, settings_models())
    except Exception as problem:  # noqa: BLE001 - a model of another package may raise anything
        return replace(context, overrides=_default_lsl().overrides, problem=problem)
    return replace(
        context,
        overrides=loaded.lsl.overrides,
        devices=loaded.devices,
        keep_awake=loaded.power.keep_awake,
    )


def _streams(device: DeviceSettings) -> int:
    try:
        return len(declared(device).streams)
    except SpecError:
        return 0


def _default_lsl() -> LslSettings:
    try:
        return GatewaySettings().lsl
    except ValidationError:
        return LslSettings()


def settings(context: Context) -> Iterator[Finding]:
    """Check whether the settings can be used, and whether an agent runs with them."""
    yield from _file(context)
    yield _state_folder(context.state_folder)
    yield _agent(context)


def _file(context: Context) -> Iterator[Finding]:
    path, problem = context.settings_path, context.problem
    if problem is None and not path.exists():
        yield note(
            f"there is no settings file {path}",
            _NOTHING_STREAMS,
            "biosensor-gateway config init\nbiosensor-gateway scan",
        )
        return
    if isinstance(problem, ConfigError):
        for line in str(problem).splitlines():
            yield error(
                line.strip(),
                "The agent does not start until every line of its settings is correct.",
                f"correct it (biosensor-gateway config edit opens {path}), "
                "then: biosensor-gateway config check",
            )
        return
    if problem is not None:
        yield error(
            f"the settings cannot be read: {type(problem).__name__}: {problem}",
            "A driver or one of its libraries is damaged; the agent does not start.",
            "install Biosensor Gateway again, then: biosensor-gateway config check",
        )
        return
    yield from _devices(context)


def _devices(context: Context) -> Iterator[Finding]:
    path, devices, enabled = context.settings_path, context.devices, context.enabled
    if not devices:
        yield warning(
            f"{path}: no device is described",
            _NOTHING_STREAMS,
            "biosensor-gateway scan\nand add the lines that it prints: biosensor-gateway config "
            "edit",
        )
    elif not enabled:
        yield warning(
            f"{path}: no device is enabled ({len(devices)} described)",
            _NOTHING_STREAMS,
            "set enabled = true: biosensor-gateway config edit",
        )
    else:
        names = ", ".join(f"{device.sensor} {device.unit}" for device in enabled)
        yield ok(f"{path}: {len(enabled)} of {len(devices)} devices enabled: {names}")


def _state_folder(folder: Path) -> Finding:
    # A missing folder is not created here, but later by the agent.
    existing = next((each for each in (folder, *folder.parents) if each.exists()), folder)
    try:
        with tempfile.TemporaryFile(dir=existing):
            pass
    except OSError as problem:
        return error(
            f"the state folder {folder} cannot be written: {problem.strerror or problem}",
            "Status, logs and the lock against a second agent are kept there.",
            f"make {existing} a folder that you can write to, or set BIOSENSOR_GATEWAY_STATE to "
            "another one",
        )
    return ok(f"state folder {folder}, {'writable' if existing == folder else 'can be made'}")


def _agent(context: Context) -> Finding:
    folder = context.state_folder
    if not is_held(folder):
        return ok("no agent runs at the moment")
    try:
        status = status_file.read_status(folder)
    except ConfigError as problem:
        return warning(
            f"an agent runs, but does not report: {problem}",
            "It is starting, ending or stuck.",
            "wait a few seconds and look again: biosensor-gateway status; if nothing changes: "
            "biosensor-gateway stop",
        )
    other = status_file.other_session(status, context.overrides)
    if other:
        return error(
            other,
            "A recorder, features or a page started now record and show none of its streams.",
            "biosensor-gateway stop\nand then, as before: biosensor-gateway run",
        )
    states = ", ".join(f"{each['sensor']} {each['state']}" for each in status["devices"])
    return ok(f"an agent runs (process {status['process']}): {states or 'no devices'}")
