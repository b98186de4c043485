"""The virtual device's side of the conversation: requests, answers, lifesigns.

Pure: bytes and the time come in, bytes go out.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from math import inf

from biosensor_gateway.devices.zephyr.simulator.wire import (
    REQUESTS,
    Packet,
    Request,
    RequestReader,
    frame,
    response,
)

_SWITCH_VALUES = (b"\0", b"\1")
_SUMMARY_PERIODS = (b"\0\0", b"\1\0")


@dataclass
class Session:
    """One host's connection; what it switched on is forgotten with it.

    Parameters
    ----------
    summary_supported
        False for firmware that has general data (0x20) only.
    host_timeout_s
        A host that says nothing for so long is dropped; None = never.
    lifesign_s
        Between two lifesigns of the device.
    answer_delay_s
        From a request to its answer.
    refused, ignored
        Request ids that get a NAK, or no answer; neither takes effect.
    """

    summary_supported: bool = True
    host_timeout_s: float | None = 10.0
    lifesign_s: float = 3.0
    answer_delay_s: float = 0.0
    refused: set[int] = field(default_factory=set[int])
    ignored: set[int] = field(default_factory=set[int])

    def __post_init__(self) -> None:
        self._reader = RequestReader()
        self._enabled: frozenset[Packet] = frozenset()
        self._answers: deque[tuple[float, bytes]] = deque()
        self._heard_at: float | None = None
        self._lifesign_at = inf

    @property
    def enabled(self) -> frozenset[Packet]:
        """The periodic packets that the host has switched on."""
        return self._enabled

    @property
    def active(self) -> bool:
        """Whether a host has spoken on this connection."""
        return self._heard_at is not None

    def hear(self, data: bytes, now: float) -> list[Request]:
        """Take the host's bytes, heard at ``now`` [s]; return the requests in them."""
        if self._heard_at is None:
            self._lifesign_at = now + self.lifesign_s
        self._heard_at = now
        requests = self._reader.feed(data, now)
        for request in requests:
            self._obey(request, now)
        return requests

    def say(self, now: float) -> list[bytes]:
        """Return the answers and the lifesign that are due at ``now`` [s]."""
        frames: list[bytes] = []
        while self._answers and self._answers[0][0] <= now:
            frames.append(self._answers.popleft()[1])
        if self._lifesign_at <= now:
            self._lifesign_at = now + self.lifesign_s
            frames.append(frame(Packet.LIFESIGN))
        return frames

    def next_due(self) -> float:
        """Return when something is to be said or the host is to be dropped [s]."""
        answer = self._answers[0][0] if self._answers else inf
        return min(answer, self._lifesign_at, self._drop_at())

    def host_is_lost(self, now: float) -> bool:
        """Tell whether the host has been silent for too long."""
        return self._drop_at() <= now

    def forget_enables(self) -> None:
        """Take it that the host has enabled nothing; the connection stays."""
        self._enabled = frozenset()

    def forget(self) -> None:
        """End the connection: nothing is enabled, nothing is owed."""
        self.__post_init__()

    def _drop_at(self) -> float:
        if self._heard_at is None or self.host_timeout_s is None:
            return inf
        return self._heard_at + self.host_timeout_s

    def _obey(self, request: Request, now: float) -> None:
        request_id = request.request_id
        if request_id in self.ignored or (request_id == Packet.LIFESIGN and request.intact):
            return
        accepted = self._is_acceptable(request)
        if accepted:
            packet = REQUESTS[request_id]
            self._enabled = (
                self._enabled | {packet} if any(request.payload) else self._enabled - {packet}
            )
        self._answers.append((now + self.answer_delay_s, response(request_id, accepted=accepted)))

    def _is_acceptable(self, request: Request) -> bool:
        packet = REQUESTS.get(request.request_id)
        if not request.intact or packet is None or request.request_id in self.refused:
            return False
        if packet is Packet.SUMMARY:
            return self.summary_supported and request.payload in _SUMMARY_PERIODS
        return request.payload in _SWITCH_VALUES
