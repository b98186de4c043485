"""Serves a read-only view to other computers: over TLS, with a separate token."""

from __future__ import annotations

import contextlib
import datetime
import ipaddress
import socket
from collections.abc import AsyncGenerator, Sequence
from pathlib import Path, PurePath
from typing import NamedTuple

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import NameOID
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from biosensor_common.doctor.interfaces import adapters
from biosensor_common.errors import TransportError, TransportReason
from biosensor_gateway.page.auth import DOOR, BrowserRules, Guard, ViewKeys
from biosensor_gateway.page.live_feed import live
from biosensor_gateway.page.models import ShareView, StatusView
from biosensor_gateway.page.server import PEOPLE, listening_at, served_alongside
from biosensor_gateway.page.session import Session
from biosensor_gateway.page.static_files import PREFIX, Front
from biosensor_gateway.system import state_file

EVERYWHERE = "0.0.0.0"  # noqa: S104 - asked for, and nothing can be changed there
_REFUSED = (
    "The address for viewing is shown on the page of the computer that the sensors are connected "
    "to. It changes each time the page is started there."
)
CERTIFICATE_FILE = "page-certificate.pem"
_CERTIFICATE_HOLDS = datetime.timedelta(days=365)
_RENEWED_BEFORE_END = datetime.timedelta(days=30)
_ISSUER = "Biosensor Gateway"


@contextlib.asynccontextmanager
async def shared(session: Session, pages: Path, port: int) -> AsyncGenerator[ShareView]:
    """Serve the view for other computers while the context lasts.

    Parameters
    ----------
    session
        State to show; its `share` is set.
    port
        Port on every network of this computer; 0 for any free port.

    Raises
    ------
    TransportError
        ``BUSY`` if the port is taken; ``ABSENT`` if there is no network, or the
        certificate cannot be stored.
    """
    with _listening(port) as listening:
        number: int = listening.getsockname()[1]
        addresses = _addresses()
        names = [*addresses, socket.gethostname().lower()]
        try:
            certificate = own_certificate(session.folder, names)
        except OSError as error:
            message = (
                "other computers cannot view the page: the certificate cannot be stored in "
                f"{session.folder} ({error.strerror or error})"
            )
            raise TransportError(TransportReason.ABSENT, message) from error
        keys = ViewKeys(number)
        session.share = view = ShareView(
            addresses=[f"https://{each}:{number}{DOOR}?token={keys.token}" for each in addresses],
            fingerprint=certificate.fingerprint,
        )
        rules = BrowserRules([f"https://{name}:{number}" for name in names], keys, _REFUSED)
        guard = Guard(view_of(session, pages), rules)
        async with served_alongside(guard, listening, PEOPLE, certificate.file):
            yield view


def view_of(session: Session, pages: Path) -> Front:
    """Return the read-only application."""

    async def status(_request: Request) -> Response:
        return Response(_status(session).model_dump_json(), media_type="application/json")

    front = Front(pages, "view.html")
    front.show(live(session, lambda: _status(session)))
    front.complete(Starlette(routes=[Route(f"{PREFIX}/status", status)]))
    return front


def _status(session: Session) -> StatusView:
    """Return the status without paths of this computer."""
    status = session.status()
    recording = status.recording
    verdict = recording.verdict
    if verdict is not None:
        names = {each: PurePath(getattr(verdict, each)).name for each in ("file", "salvaged")}
        verdict = verdict.model_copy(update=names)
    shown = recording.model_copy(
        update={"folder": "", "file": PurePath(recording.file).name, "verdict": verdict}
    )
    return status.model_copy(
        update={
            "share": None,
            "experiments": None,
            "settings_file": "",
            "problem": "The settings file has a mistake." if status.problem else "",
            "recording": shown,
            "replay": status.replay.model_copy(update={"said": []}),
        }
    )


def _listening(port: int) -> socket.socket:
    try:
        return listening_at(EVERYWHERE, port)
    except OSError as error:
        message = (
            f"other computers cannot view the page: TCP {port} cannot be opened "
            f"({error.strerror or error}); choose another with --share-port"
        )
        raise TransportError(TransportReason.BUSY, message) from error


def _addresses() -> Sequence[str]:
    """Return the IPv4 addresses by which other computers reach this one."""
    found = [each for each in adapters() if not each.is_loopback]
    addresses = [address for each in found for address in each.addresses]
    if not addresses:
        message = (
            "other computers cannot view the page: this computer is not connected to a network"
        )
        raise TransportError(TransportReason.ABSENT, message)
    return addresses


class Certificate(NamedTuple):
    """A self-signed certificate."""

    file: Path  # Certificate and private key, as PEM, readable only by this user.
    fingerprint: str  # SHA-256, as browsers show it.


def own_certificate(folder: Path, names: Sequence[str]) -> Certificate:
    """Return the certificate in a folder; create it if it is missing, expiring or for other names.

    The same certificate is used as long as possible, because a browser asks about each new one.

    Parameters
    ----------
    names
        Names and addresses by which other computers call this one.

    Raises
    ------
    OSError
        If the folder cannot be written.
    """
    file = folder / CERTIFICATE_FILE
    kept = _kept(file)
    if kept is None or not _serves(kept, names):
        kept = _made(file, names)
    digest = kept.fingerprint(hashes.SHA256())
    return Certificate(file, ":".join(f"{byte:02X}" for byte in digest))


def _kept(file: Path) -> x509.Certificate | None:
    try:
        text = file.read_bytes()
        serialization.load_pem_private_key(text, None)
        return x509.load_pem_x509_certificate(text)
    except (OSError, ValueError, TypeError):
        return None


def _serves(certificate: x509.Certificate, names: Sequence[str]) -> bool:
    left = certificate.not_valid_after_utc - datetime.datetime.now(datetime.UTC)
    kept = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    return left > _RENEWED_BEFORE_END and set(_alternatives(names)) <= set(kept)


def _made(file: Path, names: Sequence[str]) -> x509.Certificate:
    key = ec.generate_private_key(ec.SECP256R1())
    title = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, _ISSUER)])
    now = datetime.datetime.now(datetime.UTC)
    certificate = (
        x509.CertificateBuilder()
        .subject_name(title)
        .issuer_name(title)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        # A day in the past, because the clocks of two computers differ.
        .not_valid_before(now - datetime.timedelta(days=1))
        .not_valid_after(now + _CERTIFICATE_HOLDS)
        .add_extension(x509.SubjectAlternativeName(_alternatives(names)), critical=False)
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(
            x509.ExtendedKeyUsage([x509.oid.ExtendedKeyUsageOID.SERVER_AUTH]), critical=False
        )
        .sign(key, hashes.SHA256())
    )
    secret = key.private_bytes(
        serialization.Encoding.PEM,
        serialization.PrivateFormat.PKCS8,
        serialization.NoEncryption(),
    )
    public = certificate.public_bytes(serialization.Encoding.PEM)
    state_file.replace(file, (secret + public).decode(), private=True)
    return certificate


def _alternatives(names: Sequence[str]) -> list[x509.GeneralName]:
    return [_alternative(name) for name in names]


def _alternative(name: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ipaddress.ip_address(name))
    except ValueError:
        return x509.DNSName(name)
