"""Edits an ``lsl_api.cfg`` so that LabRecorder finds every stream.

LabRecorder carries liblsl 1.17. On a computer without an active network adapter that
sees one local stream of many, whichever, unless ``KnownPeers`` names the computer
itself; and it asks known peers on ``PortRange`` ports only, 32 by default, which is 16
streams. ``SessionID`` separates: both sides must have the same.

A file that is there already is edited line by line, so that its other settings and its
comments stay as they are.
"""

from __future__ import annotations

import difflib
from collections.abc import Sequence

from biosensor_common.lsl.api_file import (
    LOOPBACK,
    PEERS,
    PORT_RANGE,
    SESSION,
    Line,
    LslApiFile,
    Ports,
)

__all__ = ["LOOPBACK", "LslFile", "Ports", "changes"]

_HEADER = """\
; Settings of the Lab Streaming Layer for LabRecorder and the other LSL programs of this
; computer, written by `biosensor-gateway config lsl`.
"""
_WHY_SESSION = ("; The session of the agent: LSL programs see no streams of other sessions.",)
_WHY_PORTS = (
    "; Covers the ports of the agent's streams, two each. LSL's default of 32 is enough for 16",
    "; streams, and known peers are not asked for more.",
)
_WHY_LOOPBACK = (
    "; LabRecorder and the agent are on this computer. Without a network adapter that is up,",
    "; LabRecorder (liblsl 1.17) sees one stream of many, unless it asks this computer directly.",
)
_WHY_PEERS = ("; The computers to ask directly, because multicast may not get through to them.",)
_OWN_COMMENTS = frozenset((*_WHY_SESSION, *_WHY_PORTS, *_WHY_LOOPBACK, *_WHY_PEERS))


class LslFile(LslApiFile):
    """The text of a configuration that can be adapted.

    Parameters
    ----------
    text
        The whole file; empty for a new one.
    source
        What to call it in messages.

    Raises
    ------
    ConfigError
        ``MALFORMED``, if liblsl would not understand it and therefore ignore it.
    """

    def __init__(self, text: str, source: str) -> None:
        super().__init__(text or _HEADER, source)
        self._newline = "\r\n" if "\r\n" in text else "\n"

    @property
    def text(self) -> str:
        """The file as it is now."""
        return "".join(line.text for line in self._lines)

    def adapt(self, session_id: str, known_peers: Sequence[str], port_range: int) -> None:
        """Make it hold what LabRecorder needs; other peers and a larger range of ports stay.

        Parameters
        ----------
        session_id
            The agent's.
        known_peers
            Hosts to ask directly.
        port_range
            Number of ports that the agent's streams may have.
        """
        if self._get(SESSION) != session_id:
            self._set(SESSION, session_id, _WHY_SESSION)
        peers = tuple(dict.fromkeys((*self.known_peers, *known_peers)))
        if peers != self.known_peers or not self._get(PEERS).startswith("{"):
            self._set(PEERS, "{" + ", ".join(peers) + "}", _why_peers(peers))
        if self._number(PORT_RANGE, 0) < port_range:
            self._set(PORT_RANGE, str(port_range), _WHY_PORTS)

    def _set(self, name: tuple[str, str], value: str, why: Sequence[str]) -> None:
        section, key = name
        block = [
            *(Line(comment + self._newline, section) for comment in why),
            Line(f"{key} = {value}{self._newline}", section, key, value),
        ]
        start, end = self._place(name)
        self._lines[start:end] = block

    def _place(self, name: tuple[str, str]) -> tuple[int, int]:
        """Lines to replace: the old setting with our comments above it, or none."""
        section, _ = name
        for at, line in enumerate(self._lines):
            if (line.section, line.key) == name:
                start = at
                while start and self._lines[start - 1].text.strip() in _OWN_COMMENTS:
                    start -= 1
                return start, at + 1
        self._end_last_line()
        in_section = [at for at, line in enumerate(self._lines) if line.section == section]
        if in_section:
            filled = [at for at in in_section if self._lines[at].text.strip()]
            return filled[-1] + 1, filled[-1] + 1
        heading = f"[{section}]{self._newline}"
        self._lines += [Line(self._newline, ""), Line(heading, section)]
        return len(self._lines), len(self._lines)

    def _end_last_line(self) -> None:
        if self._lines and not self._lines[-1].text.endswith("\n"):
            self._lines[-1].text += self._newline


def _why_peers(peers: Sequence[str]) -> tuple[str, ...]:
    local = _WHY_LOOPBACK if LOOPBACK in peers else ()
    others = _WHY_PEERS if any(peer != LOOPBACK for peer in peers) else ()
    return (*local, *others)


def changes(before: str, after: str) -> list[str]:
    """List the lines that differ: ``- `` before those that go, ``+ `` before those that come."""
    compared = difflib.ndiff(before.splitlines(), after.splitlines())
    return [
        # Bytes that are no UTF-8 are kept in the file; a console cannot show them.
        line.rstrip().encode("utf-8", "replace").decode()
        for line in compared
        if line[0] in "+-" and line[2:].strip()
    ]
