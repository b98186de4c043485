"""Checks the vendors' services, their secrets, and LabRecorder's remote control."""

from __future__ import annotations

import socket
import ssl
from collections.abc import Iterator

from biosensor_common.doctor.finding import Finding, error, note, ok
from biosensor_common.errors import ConfigError, CredentialError
from biosensor_gateway.doctor.context import Context
from biosensor_gateway.doctor.device_kinds import Service, services

CONNECT_S = 3.0
_LOCAL = "127.0.0.1"


def examine(context: Context) -> Iterator[Finding]:
    """Connect to each, and close at once."""
    for service in services(context.enabled):
        yield _service(service)
    yield from _secrets(context)
    yield lab_recorder(context.lab_recorder_port)


def _service(service: Service) -> Finding:
    where = f"{service.title}: {service.host}:{service.port}"
    try:
        with socket.create_connection((service.host, service.port), CONNECT_S) as connection:
            if service.ca_file is not None:
                from biosensor_gateway.transports.websocket import tls_context

                context = tls_context(service.ca_file)
                context.wrap_socket(connection, server_hostname=service.host).close()
    except ssl.SSLError as problem:
        return error(
            f"{where} answers, but not with a certificate that is trusted "
            f"({problem.reason or problem})",
            "The agent passes no secret on to whom it does not know.",
            f"install {service.program} on this computer, or set ca_file to the vendor's root "
            "certificate: biosensor-gateway config edit",
        )
    except ConfigError as problem:
        return error(
            str(problem),
            "The service cannot be trusted without it.",
            "correct ca_file: biosensor-gateway config edit",
        )
    except OSError as problem:
        return error(
            f"{where} does not answer ({problem.strerror or problem})",
            "The agent goes on trying, and streams nothing of this device until it does.",
            f"start {service.program} on that computer and log in there; if it runs elsewhere: "
            "biosensor-gateway config edit",
        )
    return ok(f"{where} answers{'' if service.ca_file is None else ' with a trusted certificate'}")


def _secrets(context: Context) -> Iterator[Finding]:
    sensors = dict.fromkeys(device.sensor for device in context.enabled)
    if not sensors:
        return
    from biosensor_gateway.devices.registry import driver  # brings all drivers' libraries
    from biosensor_gateway.settings.secrets import find_secret

    for sensor in sensors:
        for secret in driver(sensor).secrets:
            try:
                find_secret(secret)
            except CredentialError as problem:
                yield error(
                    str(problem),
                    "The vendor's service refuses programs that it does not know.",
                    f"biosensor-gateway secrets set {sensor}",
                )
            else:
                yield ok(f"{sensor}: {secret.title} is there")


def lab_recorder(port: int) -> Finding:
    """Look whether LabRecorder can be steered from here."""
    try:
        socket.create_connection((_LOCAL, port), CONNECT_S).close()
    except OSError:
        return note(
            f"LabRecorder's remote control does not answer on TCP {port}",
            "LabRecorder is not running here, or its remote control is off. Only scripts that "
            "start and stop recordings need it.",
            "start LabRecorder and tick 'Enable RCS'",
        )
    return ok(f"something answers on TCP {port}, LabRecorder's remote control")
