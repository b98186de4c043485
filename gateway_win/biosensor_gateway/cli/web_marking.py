"""``biosensor-gateway mark --web``: what a web experiment needs in order to send markers."""

from __future__ import annotations

import shutil
import socket
import sys
from collections.abc import Iterator
from importlib.resources import as_file, files
from pathlib import Path

import typer

from biosensor_common.errors import ConfigError, ConfigReason
from biosensor_common.terminal import columns, wrapped
from biosensor_gateway.cli.loading import settings_or_defaults
from biosensor_gateway.page.experiments.token import experiment_token, new_experiment_token
from biosensor_gateway.settings.places import state_folder
from biosensor_gateway.settings.web_markers import OF_NO_SITE, USUAL_PORT, WebMarkerSettings

_EXAMPLE = 'origins = ["http://localhost:8080"]'
_LEAD = 9
_LISTENS_WITHIN_S = 1.0


def show(*, renew: bool) -> None:
    """Print address, token and origins, and where each experiment is opened.

    Parameters
    ----------
    renew
        Make another token first.

    Raises
    ------
    ConfigError
        The settings are wrong, or the token can neither be read nor written.
    """
    folder = state_folder()
    token = new_experiment_token(folder) if renew else experiment_token(folder)
    web = _settings()
    for lead, said in _rows(web, token):
        # A token or an address that is cut into two is no good to copy.
        text = f"{lead:{_LEAD}}{said}"
        fits = " " not in said
        typer.echo(text if fits else wrapped(text, columns(sys.stdout), hang=_LEAD))


def save(folder: Path) -> None:
    """Write the script for web experiments and an example into a folder.

    Raises
    ------
    ConfigError
        ``EXISTS`` if one of them is there already, ``UNREADABLE`` if it cannot be written.
    """
    with as_file(files("biosensor_gateway.page.experiments") / "files") as found:
        for source in sorted(found.iterdir()):
            target = folder / source.name
            try:
                folder.mkdir(parents=True, exist_ok=True)
                if target.exists() and target.read_bytes() != source.read_bytes():
                    message = f"{target} exists and is not overwritten; move it away first"
                    raise ConfigError(ConfigReason.EXISTS, message)
                shutil.copyfile(source, target)
            except OSError as error:
                message = f"cannot write {target}: {error.strerror or error}"
                raise ConfigError(ConfigReason.UNREADABLE, message) from error
            typer.echo(f"wrote {target}")


def _settings() -> WebMarkerSettings:
    return settings_or_defaults(None).markers.web


def _rows(web: WebMarkerSettings, token: str) -> Iterator[tuple[str, str]]:
    yield "address", f"ws://127.0.0.1:{web.port}"
    yield "token", token
    if not web.origins:
        yield (
            "origins",
            f"none, so nothing listens; in the settings, write under [markers.web]: {_EXAMPLE}",
        )
        return
    port = "" if web.port == USUAL_PORT else f"&port={web.port}"
    for lead, origin in zip(["origins"] + [""] * len(web.origins), web.origins, strict=False):
        is_site = origin != OF_NO_SITE
        yield lead, f"{origin}/#gateway={token}{port}" if is_site else "null (a page from a file)"
    if not _listens(web.port):
        yield "", "nothing listens there yet; open the page: biosensor-gateway page"


def _listens(port: int) -> bool:
    try:
        socket.create_connection(("127.0.0.1", port), _LISTENS_WITHIN_S).close()
    except OSError:
        return False
    return True
