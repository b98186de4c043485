"""Gives the checks of the agent's computer the settings and the folders."""

from __future__ import annotations

import sys
from dataclasses import dataclass, field, replace
from pathlib import Path

from pydantic import ValidationError

from biosensor_common.doctor import context as common
from biosensor_common.doctor.guide import Guide
from biosensor_common.errors import ConfigError, SpecError
from biosensor_gateway.agent import status_file
from biosensor_gateway.agent.single_instance import is_held
from biosensor_gateway.devices.registry import declared
from biosensor_gateway.settings.models import DeviceSettings, GatewaySettings, LslSettings

LAB_RECORDER_PORT = 22345

_PIP = f"{sys.executable} -m pip install --force-reinstall"

GUIDE = Guide(
    program="the agent",
    package="biosensor_gateway",
    distribution="biosensor-gateway",
    install=f"in the folder of the project: {sys.executable} -m pip install .",
    install_pylsl=f"{_PIP} pylsl",
    libraries={name: f"{_PIP} {name}" for name in ("bleak", "numpy")},
    ask_itself="biosensor-gateway config lsl",
    ask_others="where LabRecorder is: biosensor-gateway config lsl --for two-pc --peer {peer}",
    correct_file="biosensor-gateway config lsl --force",
    edit="biosensor-gateway config edit",
    alone=(
        "run it alone: biosensor-gateway doctor --only {check}; if it fails again, report it with "
        "the output of: biosensor-gateway doctor --json"
    ),
)


@dataclass(frozen=True, slots=True)
class Context(common.Context):
    """The computer and the settings that are examined.

    Attributes
    ----------
    settings_path
        The settings file, whether it is there or not.
    state_folder
        Where a running agent has its status.
    devices
        What the file says; no devices where it cannot be read.
    keep_awake
        Whether the agent is to hold off sleep.
    problem
        Why the settings cannot be read, or None.
    lab_recorder_port
        TCP port of LabRecorder's remote control on this computer.
    """

    settings_path: Path
    state_folder: Path
    devices: tuple[DeviceSettings, ...] = ()
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
        """The streams of the devices and the one of the agent itself; 0 if it runs already."""
        if not self.enabled or is_held(self.state_folder):
            return 0
        return 1 + sum(_streams(device) for device in self.enabled)

    @property
    def offered(self) -> frozenset[str]:
        """The source_ids of the streams that the running agent says it has open."""
        try:
            status = status_file.read_status(self.state_folder)
        except ConfigError:
            return frozenset()
        return frozenset(source for device in status["devices"] for source in device["streams"])


def read_context(
    settings_path: Path, state_folder: Path, lab_recorder_port: int = LAB_RECORDER_PORT
) -> Context:
    """Read the settings; what is wrong with them is kept for the check of the settings."""
    context = Context(settings_path, state_folder, lab_recorder_port=lab_recorder_port)
    try:
        # The drivers, which the models come from, bring all their libraries.
        from biosensor_gateway.devices.registry import settings_models
        from biosensor_gateway.settings.file import load_settings

        loaded = load_settings(settings_path, settings_models())
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
