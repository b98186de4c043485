"""The circumstances that a virtual Cortex finds itself in, besides its headset."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from biosensor_gateway.devices.emotiv_insight.simulator.account import App, User
from biosensor_gateway.devices.emotiv_insight.simulator.certificates import Leaf
from biosensor_gateway.devices.emotiv_insight.simulator.errors import Code
from biosensor_gateway.devices.emotiv_insight.simulator.release import Release

APP = App("virtual-app", "virtual-secret-0123456789")
RELEASE = Release("4.8.32")
_SUBSCRIPTION_DELAY_S = 0.3


@dataclass(frozen=True)
class Circumstances:
    """Its version, its user, its computer, and its manners.

    Attributes
    ----------
    release
        Version of Cortex.
    app
        The registered app.
    other_apps
        Secrets of further apps by client id; the user has approved them.
    user
        As they are at first.
    unlicensed_metrics_s
        Between two samples of ``met`` where the licence does not cover it [s].
    bluetooth_permitted
        False: the operating system keeps Cortex from Bluetooth.
    neighbours
        Ids of other headsets in the list.
    leaf, ca_without_key_usage
        What the server's certificate and that of its authority look like.
    reply_delays_s
        By method; answers overtake each other where these differ.
    data_before_reply
        Samples come before the reply to the subscription that asks for them.
    refusal_code
        Error of the fault REFUSE.
    """

    release: Release = RELEASE
    app: App = APP
    other_apps: Mapping[str, str] = field(default_factory=dict[str, str])
    user: User = field(default_factory=User)
    unlicensed_metrics_s: float = 10.0
    bluetooth_permitted: bool = True
    neighbours: tuple[str, ...] = ()
    leaf: Leaf = Leaf.VALID
    ca_without_key_usage: bool = False
    reply_delays_s: Mapping[str, float] = field(default_factory=dict[str, float])
    data_before_reply: bool = False
    refusal_code: int = Code.INTERNAL

    @property
    def secrets(self) -> dict[str, str]:
        """Secrets of all apps by client id."""
        return {**self.other_apps, self.app.client_id: self.app.client_secret}

    @property
    def approved_apps(self) -> set[str]:
        """Client ids of the apps that the user has approved."""
        return {*self.other_apps, *([self.app.client_id] if self.user.approved else [])}

    @property
    def delays_s(self) -> dict[str, float]:
        """How late each method is answered that is not answered at once [s]."""
        late = {"subscribe": _SUBSCRIPTION_DELAY_S} if self.data_before_reply else {}
        return late | dict(self.reply_delays_s)
