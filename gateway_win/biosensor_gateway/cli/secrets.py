"""``biosensor-gateway secrets``: credentials for vendors' services, in the system's keyring."""

from __future__ import annotations

from typing import Annotated

import typer

from biosensor_common.errors import ConfigError, ConfigReason, CredentialError, SpecError
from biosensor_gateway.devices.registry import driver, sensor_names
from biosensor_gateway.settings import secrets as secret_store
from biosensor_gateway.settings.secrets import SecretName

app = typer.Typer(no_args_is_help=True)


@app.callback()
def _group() -> None:
    """Secrets in the keyring of the system."""


_WHOSE = "Whose secrets: a sensor, or its vendor."
SensorArgument = Annotated[str, typer.Argument(help=_WHOSE)]
OptionalSensor = Annotated[str | None, typer.Argument(help=_WHOSE)]
EveryOption = Annotated[bool, typer.Option("--all", help="The secrets of all sensors.")]


@app.command("set")
def set_secrets(sensor: SensorArgument) -> None:
    """Ask for the secrets of a sensor's service and store them; nothing is shown."""
    for secret in _secrets_of(sensor):
        # Never an argument: the process list and the shell's history would have it.
        value: str = typer.prompt(_sentence(secret), hide_input=True)
        secret_store.set_secret(secret, value)
    typer.echo(f"the secrets of {sensor} are in the keyring")


@app.command("forget")
def forget_secrets(sensor: OptionalSensor = None, *, every: EveryOption = False) -> None:
    """Remove the secrets of a sensor's service, or all secrets, from the keyring."""
    if (sensor is not None) == every:
        raise typer.BadParameter("name a sensor, or use --all")
    for secret in _all_secrets() if sensor is None else _secrets_of(sensor):
        was_there = secret_store.forget_secret(secret)
        outcome = "removed from the keyring" if was_there else "was not in the keyring"
        typer.echo(f"{_sentence(secret)}: {outcome}")


@app.command("check")
def check_secrets(sensor: SensorArgument) -> None:
    """Show where the secrets of a sensor's service are found; exit code 1 if one is missing."""
    problems: list[str] = []
    for secret in _secrets_of(sensor):
        try:
            typer.echo(f"{_sentence(secret)}: {secret_store.secret_origin(secret)}")
        except CredentialError as error:
            problems.append(str(error))
    for problem in problems:
        typer.echo(f"! {problem}")
    if problems:
        raise typer.Exit(1)


def _by_sensor() -> dict[str, tuple[SecretName, ...]]:
    return {name: driver(name).secrets for name in sensor_names() if driver(name).secrets}


def _all_secrets() -> tuple[SecretName, ...]:
    return tuple(secret for secrets in _by_sensor().values() for secret in secrets)


def _secrets_of(sensor: str) -> tuple[SecretName, ...]:
    known = _by_sensor()
    # A sensor's name begins with its vendor's, which is enough if it fits only one.
    matching = [name for name in known if name == sensor or name.startswith(f"{sensor}_")]
    if len(matching) == 1:
        return known[matching[0]]
    try:
        driver(sensor)
    except SpecError as error:
        # An unknown sensor is a wrong argument, which ends with exit code 2.
        raise ConfigError(ConfigReason.WRONG_VALUE, str(error)) from error
    message = f"{sensor} needs no secrets; these do: {', '.join(known)}"
    raise ConfigError(ConfigReason.WRONG_VALUE, message)


def _sentence(secret: SecretName) -> str:
    return secret.title[:1].upper() + secret.title[1:]
