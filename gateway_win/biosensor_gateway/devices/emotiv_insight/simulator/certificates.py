"""The certificates of a virtual Cortex: an authority of its own, and a server's leaf."""

from __future__ import annotations

import datetime
import ssl
from enum import Enum, auto

import trustme
from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat
from cryptography.x509.oid import NameOID

_HOST = "localhost"
_LONG_AGO = datetime.datetime(2000, 1, 1, tzinfo=datetime.UTC)
_YESTERYEAR = datetime.datetime(2020, 1, 1, tzinfo=datetime.UTC)
_FAR_AHEAD = datetime.datetime(2073, 11, 8, tzinfo=datetime.UTC)


class Leaf(Enum):
    """What the server shows to a client that trusts the authority."""

    VALID = auto()
    EXPIRED = auto()
    WRONG_NAME = auto()
    UNTRUSTED = auto()
    """Signed by an authority that the client does not know."""


class Authority:
    """A certificate authority that signs one server.

    Parameters
    ----------
    has_key_usage
        False: its certificate lacks the keyUsage extension, as that of the vendor
        does; OpenSSL's strict mode, the default from Python 3.13 on, refuses it.
    """

    def __init__(self, *, has_key_usage: bool) -> None:
        self._authority = trustme.CA() if has_key_usage else _without_key_usage()

    @property
    def pem(self) -> bytes:
        """Its certificate, for a client to trust."""
        return self._authority.cert_pem.bytes()

    def server_context(self, leaf: Leaf) -> ssl.SSLContext:
        """TLS of a server on this machine."""
        signer = trustme.CA() if leaf is Leaf.UNTRUSTED else self._authority
        certificate = signer.issue_cert(
            "cortex.invalid" if leaf is Leaf.WRONG_NAME else _HOST,
            not_before=_LONG_AGO,
            not_after=_YESTERYEAR if leaf is Leaf.EXPIRED else _FAR_AHEAD,
        )
        context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
        with certificate.private_key_and_cert_chain_pem.tempfile() as path:
            context.load_cert_chain(path)
        return context


def _without_key_usage() -> trustme.CA:
    key = ec.generate_private_key(ec.SECP256R1())
    name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "Virtual Cortex root")])
    certificate = (
        x509.CertificateBuilder()
        .subject_name(name)
        .issuer_name(name)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(_LONG_AGO)
        .not_valid_after(_FAR_AHEAD)
        .add_extension(x509.BasicConstraints(ca=True, path_length=None), critical=True)
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(key.public_key()), critical=False)
        .sign(key, hashes.SHA256())
    )
    return trustme.CA.from_pem(
        certificate.public_bytes(Encoding.PEM),
        key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()),
    )
