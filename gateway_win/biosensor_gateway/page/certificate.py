"""A certificate of this computer's own, for the page as other computers see it."""

from __future__ import annotations

import datetime
import ipaddress
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import NameOID

from biosensor_gateway.system import state_file

FILE = "page-certificate.pem"
_VALID = datetime.timedelta(days=365)
_RENEWED = datetime.timedelta(days=30)
_TITLE = "Biosensor Gateway"


class Certificate(NamedTuple):
    """A certificate that nobody has vouched for.

    Attributes
    ----------
    file
        Certificate and private key, as PEM, for this user alone.
    fingerprint
        SHA-256, as browsers show it.
    """

    file: Path
    fingerprint: str


def own_certificate(folder: Path, names: Sequence[str]) -> Certificate:
    """Return the certificate that is kept in a folder; make it where it does not serve.

    The same one is used for as long as possible, because a browser asks about each new one.

    Parameters
    ----------
    folder
        The state folder.
    names
        Names and addresses by which other computers call this one.

    Raises
    ------
    OSError
        The folder cannot be written.
    """
    file = folder / FILE
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
    return left > _RENEWED and set(_alternatives(names)) <= set(kept)


def _made(file: Path, names: Sequence[str]) -> x509.Certificate:
    key = ec.generate_private_key(ec.SECP256R1())
    title = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, _TITLE)])
    now = datetime.datetime.now(datetime.UTC)
    certificate = (
        x509.CertificateBuilder()
        .subject_name(title)
        .issuer_name(title)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        # Clocks of two computers differ.
        .not_valid_before(now - datetime.timedelta(days=1))
        .not_valid_after(now + _VALID)
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
