"""Checks the settings file, the state folder and the running agent."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path

from biosensor_common.doctor.finding import Finding, error, note, ok, warning
from biosensor_common.errors import ConfigError, ConfigReason
from biosensor_gateway.agent import status_file
from biosensor_gateway.agent.single_instance import is_held
from biosensor_gateway.doctor.context import Context

_NOTHING_STREAMS = "The agent streams nothing without a device."


def examine(context: Context) -> Iterator[Finding]:
    """Say whether the settings can be used, and whether an agent runs with them."""
    yield from _file(context)
    yield _state_folder(context.state_folder)
    yield _agent(context.state_folder)


def _file(context: Context) -> Iterator[Finding]:
    path, problem = context.settings_path, context.problem
    if isinstance(problem, ConfigError):
        if problem.reason is ConfigReason.NOT_FOUND:
            yield note(
                f"there is no settings file {path}",
                _NOTHING_STREAMS,
                "biosensor-gateway config init\nbiosensor-gateway scan",
            )
            return
        for line in str(problem).splitlines():
            yield error(
                line.strip(),
                "The agent does not start before every line of its settings is right.",
                f"correct it (biosensor-gateway config edit opens {path}), "
                "then: biosensor-gateway config check",
            )
        return
    if problem is not None:
        yield error(
            f"the settings cannot be read: {type(problem).__name__}: {problem}",
            "A driver or a library of it is damaged; the agent does not start.",
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
    # What is not there yet is made by the agent, not by who only looks.
    existing = next((each for each in (folder, *folder.parents) if each.exists()), folder)
    try:
        with tempfile.TemporaryFile(dir=existing):
            pass
    except OSError as problem:
        return error(
            f"the state folder {folder} cannot be written: {problem.strerror or problem}",
            "Status, logs and the guard against a second agent are kept there.",
            f"make {existing} a folder that you may write to, or set BIOSENSOR_GATEWAY_STATE to "
            "another one",
        )
    return ok(f"state folder {folder}, {'writable' if existing == folder else 'can be made'}")


def _agent(folder: Path) -> Finding:

    if not is_held(folder):
        return ok("no agent runs at the moment")
    try:
        status = status_file.read_status(folder)
    except ConfigError as problem:
        return warning(
            f"an agent runs, but does not report: {problem}",
            "It is starting, ending or stuck.",
            "wait a few seconds and look again: biosensor-gateway status; if it stays so: "
            "biosensor-gateway stop",
        )
    states = ", ".join(f"{each['sensor']} {each['state']}" for each in status["devices"])
    return ok(f"an agent runs (process {status['process']}): {states or 'no devices'}")
