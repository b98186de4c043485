"""Lines of JSON over TCP between two programs that know the same code, limited in size and time.

::

    asking     {"speak": "biosensor-gateway network check", "version": 1, "nonce": ...}
    answering  {"speak": "biosensor-gateway network check", "version": 1, "nonce": ...}
    asking     {"proof": ...}
    answering  {"proof": ...} or {"refused": "code"}

The answering side sends its proof only after a valid one, so that guessing a code reveals nothing.
All later lines are sealed with a key derived from the code and both nonces.
"""

from __future__ import annotations

import hashlib
import hmac
import json
import re
import secrets
import socket
import time
from typing import Any, cast

from biosensor_common.errors import (
    CredentialError,
    CredentialReason,
    ProtocolError,
    ProtocolReason,
    TransportError,
    TransportReason,
)

LANGUAGE = "biosensor-gateway network check"
VERSION = 1
DIGITS = 6
"""Number of digits of the code that the user types on the other computer."""
GREETING_S = 5.0
MAX_GREETING = 1024
"""Largest line, in bytes, from a peer that has not proved that it knows the code."""
MAX_LINE = 256 * 1024
_READ = 16 * 1024
_SEAL = 64
_NONCE_BYTES = 16
NONCE = re.compile(rf"[0-9a-f]{{{2 * _NONCE_BYTES}}}")
# Slow enough that an eavesdropper cannot try all codes before the conversation has ended.
_ROUNDS = 200_000
_ASKING, _ANSWERING = b"asking", b"answering"

Message = dict[str, Any]


def new_code() -> str:
    """Return a random code."""
    return f"{secrets.randbelow(10**DIGITS):0{DIGITS}d}"


def read_code(text: str) -> str:
    """Return a typed code without blanks and hyphens.

    Raises
    ------
    CredentialError
        ``REJECTED``, if it is not a valid code.
    """
    code = text.replace(" ", "").replace("-", "")
    if len(code) != DIGITS or not (code.isascii() and code.isdecimal()):
        raise _rejected(
            f"{text!r} is not a code; type the {DIGITS} digits that the other computer shows"
        )
    return code


def nonce() -> str:
    """Return a number that is used once, as hexadecimal digits."""
    return secrets.token_hex(_NONCE_BYTES)


class Channel:
    """One end of a conversation; *name* denotes the other end in sentences.

    The caller closes the connection. Both directions raise `TransportError`: ``LOST`` if the other
    end is gone, ``SILENT`` after the time limit.
    """

    def __init__(self, connection: socket.socket, name: str) -> None:
        self.connection = connection
        self.name = name
        self._rest = b""
        self._key: bytes | None = None
        self._own = self._other = b""
        self._sent = self._received = 0

    def secure(self, key: bytes, own: bytes, other: bytes) -> None:
        """Seal all following lines; *own* and *other* distinguish the two directions."""
        self._key, self._own, self._other = key, own, other

    def send(self, message: Message, limit_s: float = 10.0) -> None:
        """Send a line."""
        line = json.dumps(message).encode("ascii")
        if self._key is not None:
            line = _seal(self._key, _numbered(self._own, self._sent, line)).encode("ascii") + line
            self._sent += 1
        self.connection.settimeout(limit_s)
        try:
            self.connection.sendall(line + b"\n")
        except TimeoutError as error:
            raise self._silent(limit_s) from error
        except OSError as error:
            raise self._lost() from error

    def receive(self, limit_s: float) -> Message:
        """Wait for a line.

        Raises
        ------
        ProtocolError
            ``GARBAGE`` for a line that is too long, not sealed with the key, or not a JSON object.
        """
        line = self._line(limit_s)
        if self._key is not None:
            given, line = line[:_SEAL].decode("ascii", "replace"), line[_SEAL:]
            if not _is_sealed(self._key, _numbered(self._other, self._received, line), given):
                raise self._garbage("a line without its valid seal")
            self._received += 1
        try:
            message: object = json.loads(line)
        except (ValueError, RecursionError) as error:
            raise self._garbage("a line that is not JSON") from error
        if not isinstance(message, dict):
            raise self._garbage("a line that is not a JSON object")
        return cast("Message", message)

    def _line(self, limit_s: float) -> bytes:
        end = time.monotonic() + limit_s
        most = MAX_GREETING if self._key is None else MAX_LINE
        while b"\n" not in self._rest and len(self._rest) <= most:
            left = end - time.monotonic()
            if left <= 0:
                raise self._silent(limit_s)
            self.connection.settimeout(left)
            try:
                read = self.connection.recv(_READ)
            except TimeoutError as error:
                raise self._silent(limit_s) from error
            except OSError as error:
                raise self._lost() from error
            if not read:
                raise self._lost()
            self._rest += read
        line, _, self._rest = self._rest.partition(b"\n")
        if len(line) > most:
            raise self._garbage(f"a line of more than {most} bytes")
        return line

    def _silent(self, limit_s: float) -> TransportError:
        what = f"{self.name} sent nothing for {limit_s:g} s; start both sides again"
        return TransportError(TransportReason.SILENT, what)

    def _lost(self) -> TransportError:
        what = f"{self.name} ended the conversation; start both sides again"
        return TransportError(TransportReason.LOST, what)

    def _garbage(self, what: str) -> ProtocolError:
        message = f"{self.name} sent {what}; another program seems to use that port"
        return ProtocolError(ProtocolReason.GARBAGE, message)


def greet_as_asking(channel: Channel, code: str) -> None:
    """Do the handshake as the asking side.

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
    key = _key(code, own, _nonce_of(channel.receive(GREETING_S), channel.name))
    channel.send({"proof": _seal(key, _ASKING)})
    reply = channel.receive(GREETING_S)
    if "refused" in reply or not _proves(reply, key, _ANSWERING):
        raise _rejected(f"{channel.name} shows another code; type the one shown there now")
    channel.secure(key, _ASKING, _ANSWERING)


def greet_as_answering(channel: Channel, code: str) -> None:
    """Do the handshake as the answering side; raises as `greet_as_asking` does.

    A peer with a wrong code is notified.
    """
    greeting = channel.receive(GREETING_S)
    own = nonce()
    # Sent to other versions, too, so that they can report the mismatch.
    channel.send(_greeting(own))
    key = _key(code, _nonce_of(greeting, channel.name), own)
    if not _proves(channel.receive(GREETING_S), key, _ASKING):
        channel.send({"refused": "code"})
        raise _rejected(f"{channel.name} does not know the code and was refused")
    channel.send({"proof": _seal(key, _ANSWERING)})
    channel.secure(key, _ANSWERING, _ASKING)


def _greeting(own: str) -> Message:
    return {"speak": LANGUAGE, "version": VERSION, "nonce": own}


def _nonce_of(greeting: Message, name: str) -> str:
    version, found = greeting.get("version"), str(greeting.get("nonce"))
    if greeting.get("speak") != LANGUAGE:
        what = f"{name} is another program; give the right port with --port"
        raise ProtocolError(ProtocolReason.GARBAGE, what)
    if version != VERSION:
        raise ProtocolError(
            ProtocolReason.UNSUPPORTED,
            f"{name} uses version {version!r:.20} of the network check, this computer version "
            f"{VERSION}; install the same Biosensor Gateway on both",
        )
    if not NONCE.fullmatch(found):
        raise ProtocolError(ProtocolReason.GARBAGE, f"{name} greets without a valid nonce")
    return found


def _key(code: str, asking: str, answering: str) -> bytes:
    salt = f"{asking}:{answering}".encode("ascii")
    return hashlib.pbkdf2_hmac("sha256", code.encode("ascii"), salt, _ROUNDS)


def _seal(key: bytes, words: bytes) -> str:
    return hmac.new(key, words, hashlib.sha256).hexdigest()


def _is_sealed(key: bytes, words: bytes, given: str) -> bool:
    """Whether a seal is right, compared in constant time."""
    return hmac.compare_digest(_seal(key, words).encode("ascii"), given.encode("ascii", "replace"))


def _proves(message: Message, key: bytes, role: bytes) -> bool:
    return _is_sealed(key, role, str(message.get("proof", "")))


def _numbered(direction: bytes, number: int, line: bytes) -> bytes:
    return b"%s %d " % (direction, number) + line


def _rejected(what: str) -> CredentialError:
    return CredentialError(CredentialReason.REJECTED, what)
