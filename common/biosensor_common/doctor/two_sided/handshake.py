"""Checks that two programs speak the same language and know the same code.

::

    asking     {"speak": "biosensor-gateway network check", "version": 1, "nonce": ...}
    answering  {"speak": "biosensor-gateway network check", "version": 1, "nonce": ...}
    asking     {"proof": ...}
    answering  {"proof": ...} or {"refused": "code"}

The one who answers proves nothing before the other has, so that guessing gives away nothing.
"""

from __future__ import annotations

from biosensor_common.doctor.two_sided.channel import Channel, Message
from biosensor_common.doctor.two_sided.code import is_nonce, is_sealed, key, nonce, seal
from biosensor_common.errors import (
    CredentialError,
    CredentialReason,
    ProtocolError,
    ProtocolReason,
)

LANGUAGE = "biosensor-gateway network check"
VERSION = 1
GREETING_S = 5.0
_ASKING, _ANSWERING = b"asking", b"answering"


def ask(channel: Channel, code: str) -> None:
    """Greet as the one who asks.

    Raises
    ------
    CredentialError
        ``REJECTED``: the code is wrong.
    ProtocolError
        ``UNSUPPORTED`` for another version, ``GARBAGE`` for another program.
    TransportError
    """
    own = nonce()
    channel.send(_greeting(own))
    greeting = channel.receive(GREETING_S)
    _check(greeting, channel.name)
    shared = key(code, own, greeting["nonce"])
    channel.send({"proof": seal(shared, _ASKING)})
    reply = channel.receive(GREETING_S)
    if "refused" in reply or not _proves(reply, shared, _ANSWERING):
        raise CredentialError(
            CredentialReason.REJECTED,
            f"{channel.name} shows another code; type the one that stands there now",
        )
    channel.secure(shared, _ASKING, _ANSWERING)


def answer(channel: Channel, code: str) -> None:
    """Greet as the one who answers.

    Raises
    ------
    CredentialError
        ``REJECTED``: who asks does not know the code, and was told so.
    ProtocolError
        ``UNSUPPORTED`` for another version, ``GARBAGE`` for another program.
    TransportError
    """
    greeting = channel.receive(GREETING_S)
    own = nonce()
    # Also to who speaks another version: it can say so then.
    channel.send(_greeting(own))
    _check(greeting, channel.name)
    shared = key(code, greeting["nonce"], own)
    if not _proves(channel.receive(GREETING_S), shared, _ASKING):
        channel.send({"refused": "code"})
        raise CredentialError(
            CredentialReason.REJECTED, f"{channel.name} does not know the code, and was refused"
        )
    channel.send({"proof": seal(shared, _ANSWERING)})
    channel.secure(shared, _ANSWERING, _ASKING)


def _greeting(own: str) -> Message:
    return {"speak": LANGUAGE, "version": VERSION, "nonce": own}


def _check(greeting: Message, name: str) -> None:
    if greeting.get("speak") != LANGUAGE:
        raise ProtocolError(
            ProtocolReason.GARBAGE, f"{name} is another program; name the right port with --port"
        )
    version = greeting.get("version")
    if version != VERSION:
        raise ProtocolError(
            ProtocolReason.UNSUPPORTED,
            f"{name} speaks version {version!r:.20} of the network check, this computer version "
            f"{VERSION}; install the same Biosensor Gateway on both",
        )
    if not is_nonce(greeting.get("nonce")):
        raise ProtocolError(ProtocolReason.GARBAGE, f"{name} greets without a valid nonce")


def _proves(message: Message, shared: bytes, role: bytes) -> bool:
    return is_sealed(shared, role, str(message.get("proof", "")))
