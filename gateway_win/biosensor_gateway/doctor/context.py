"""What all checks are given: the settings, and where things are."""

from __future__ import annotations

import os
from dataclasses import dataclass, field, replace
from pathlib import Path

from pydantic import ValidationError

from biosensor_common.errors import ConfigError
from biosensor_common.lsl_config import LslOverrides, effective_config, user_config_file
from biosensor_gateway.settings import DeviceSettings, GatewaySettings, LslSettings

LAB_RECORDER_PORT = 22345


@dataclass(frozen=True, slots=True)
class Context:
    """The computer and the settings that are examined.

    Attributes
    ----------
    settings_path
        The settings file, whether it is there or not.
    state_folder
        Where a running agent has its status.
    lsl, devices
        What the file says; LSL's defaults and no devices where it cannot be read.
    keep_awake
        Whether the agent is to hold off sleep.
    problem
        Why the settings cannot be read, or None.
    lab_recorder_port
        TCP port of LabRecorder's remote control on this computer.
    """

    settings_path: Path
    state_folder: Path
    lsl: LslSettings = field(default_factory=LslSettings)
    devices: tuple[DeviceSettings, ...] = ()
    keep_awake: bool = True
    problem: Exception | None = None
    lab_recorder_port: int = LAB_RECORDER_PORT

    @property
    def enabled(self) -> tuple[DeviceSettings, ...]:
        """The devices that the agent connects to."""
        return tuple(device for device in self.devices if device.enabled)

    @property
    def lsl_file(self) -> Path | None:
        """The user's own LSL configuration that LSL programs started here would read."""
        return user_config_file(os.environ, Path.home(), Path.cwd())

    @property
    def overrides(self) -> LslOverrides:
        """What the settings put over the user's own LSL configuration."""
        return LslOverrides(self.lsl.session_id, self.lsl.known_peers, self.lsl.port_range)

    @property
    def agent_config(self) -> str:
        """The LSL configuration of the agent, without the user's file if that is damaged."""
        try:
            return effective_config(self.lsl_file, self.overrides)
        except ConfigError:
            return effective_config(None, self.overrides)


def read_context(
    settings_path: Path, state_folder: Path, lab_recorder_port: int = LAB_RECORDER_PORT
) -> Context:
    """Read the settings; what is wrong with them is kept for the check of the settings."""
    try:
        # The drivers, which the models come from, bring all their libraries.
        from biosensor_gateway.devices import settings_models  # noqa: PLC0415
        from biosensor_gateway.settings_file import load_settings  # noqa: PLC0415

        loaded = load_settings(settings_path, settings_models())
    except Exception as problem:  # noqa: BLE001 - a driver that cannot be imported, too
        context = Context(settings_path, state_folder, _default_lsl(), problem=problem)
        return replace(context, lab_recorder_port=lab_recorder_port)
    return Context(
        settings_path,
        state_folder,
        loaded.lsl,
        loaded.devices,
        loaded.power.keep_awake,
        lab_recorder_port=lab_recorder_port,
    )


def _default_lsl() -> LslSettings:
    try:
        return GatewaySettings().lsl
    except ValidationError:
        return LslSettings()
