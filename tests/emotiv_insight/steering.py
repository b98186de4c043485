"""A virtual Cortex to which a test does more than there are faults."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from biosensor_gateway.devices.emotiv_insight.simulator import Licence, SimulatedCortex

_USER_LOGGED_IN, _USER_LOGGED_OUT = 2, 3
_ACCESS_GRANTED = 9


class SteeredCortex(SimulatedCortex):
    """Cortex, its user and its headset do what a test tells them."""

    @property
    def calls(self) -> tuple[str, ...]:
        """Methods that clients asked for, in order."""
        return self.world.call(lambda: tuple(self._replies.calls))

    @property
    def client_count(self) -> int:
        """Connections that stand."""
        return self.world.call(lambda: len(self._listener.clients))

    def approve(self) -> None:
        """Let the user approve the app in the Launcher."""
        self._do(lambda: self._account.approved.add(self.client_id))
        self._warn(_ACCESS_GRANTED, "The user has granted access.")

    def log_in(self) -> None:
        """Let the user log in."""
        self._do(lambda: setattr(self._account, "is_logged_in", True))
        self._warn(_USER_LOGGED_IN, "A user has logged in.")

    def log_out(self) -> None:
        """Let the user log out; tokens and sessions are forgotten."""
        self._do(self._end_login)
        self._warn(_USER_LOGGED_OUT, "The user has logged out.")

    def license(self, licence: Licence) -> None:
        """Change what the licence covers, from the next request on."""
        self._do(lambda: setattr(self._account, "licence", licence))

    def expire_token(self) -> None:
        """Let every token that was given be expired; subscriptions run on."""
        self._do(self._account.expire_tokens)

    def switch_headset_off(self, *, virtual: bool = False) -> None:
        """Send nothing more; after a silence a real headset is given up (103, 0, 1)."""
        self._do(lambda: self._headset.switch_off(is_noticed=not virtual))

    def switch_headset_on(self) -> None:
        """Send again, if Cortex has not given the headset up meanwhile."""
        self._do(self._headset.switch_on)

    def drop_samples(self, count: int) -> None:
        """Lose the next EEG samples on the radio: the counter shows it."""
        self._do(lambda: self._mishaps.lose(count))

    def skip_seconds(self, count: int) -> None:
        """Lose whole seconds of EEG: only the time shows it, the counter does not."""
        self._do(lambda: self._mishaps.lose(count * self._model.eeg_rate))

    def interpolate(self, count: int) -> None:
        """Mark the next EEG samples as filled in by Cortex."""
        self._do(lambda: self._mishaps.interpolate(count))

    def repeat_samples(self, count: int) -> None:
        """Send each of the next EEG samples twice."""
        self._do(lambda: self._mishaps.repeat(count))

    def mark(self, label: str, value: int) -> None:
        """Put a marker into the next EEG sample."""
        self._do(lambda: self._mishaps.mark(label, value))

    def time_jump(self, seconds: float) -> None:
        """Set the clock of Cortex forward or back."""
        self._do(lambda: self._step_clock(seconds))

    def withhold_reply(self, method: str) -> None:
        """Carry the next request of a method out without an answer."""
        self._do(lambda: self._manners.withheld.add(method))

    def duplicate_reply(self, method: str) -> None:
        """Answer the next request of a method twice."""
        self._do(lambda: self._manners.doubled.add(method))

    def send_raw(self, message: str | bytes) -> None:
        """Send every client any message."""
        self._do(lambda: self._send_raw(message))

    def close_connections(self, code: int) -> None:
        """Close every connection by the protocol (1000, 1001, 1011); the port stays open."""
        self._do(lambda: self._listener.close_all(code))

    def _warn(self, code: int, message: str) -> None:
        self._do(lambda: self._tell_all(code, message))

    def _end_login(self) -> None:
        self._account.is_logged_in = False
        self._account.forget_tokens()
        self._sessions.lose_all()

    def _step_clock(self, seconds: float) -> None:
        self._unix_begin_s += seconds

    def _do(self, action: Callable[[], Any]) -> None:
        self.world.call(action)
