"""A virtual Cortex to which a test does more than there are faults."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from biosensor_gateway.devices.emotiv_insight.simulator import Licence, SimulatedCortex

_USER_LOGGED_OUT = 3


class SteeredCortex(SimulatedCortex):
    """Cortex, its user and its headset do what a test tells them."""

    @property
    def calls(self) -> tuple[str, ...]:
        """Methods that clients asked for, in order."""
        return self.world.call(lambda: tuple(self._replies.calls))

    def log_out(self) -> None:
        """Let the user log out; tokens and sessions are forgotten."""
        self._do(self._end_login)

    def license(self, licence: Licence) -> None:
        """Change what the licence covers, from the next request on."""
        self._do(lambda: setattr(self._account, "licence", licence))

    def expire_token(self) -> None:
        """Let every token that was given be expired; subscriptions run on."""
        self._do(self._account.expire_tokens)

    def time_jump(self, seconds: float) -> None:
        """Set the clock of Cortex forward or back."""
        self._do(lambda: self._step_clock(seconds))

    def send_raw(self, message: str | bytes) -> None:
        """Send every client any message."""
        self._do(lambda: self._send_raw(message))

    def close_connections(self, code: int) -> None:
        """Close every connection by the protocol (1000, 1001, 1011); the port stays open."""
        self._do(lambda: self._listener.close_all(code))

    def _end_login(self) -> None:
        self._account.is_logged_in = False
        self._account.forget_tokens()
        self._sessions.forget()
        self._tell_all(_USER_LOGGED_OUT, "The user has logged out.")

    def _step_clock(self, seconds: float) -> None:
        self._unix_begin_s += seconds

    def _do(self, action: Callable[[], Any]) -> None:
        self.world.call(action)
