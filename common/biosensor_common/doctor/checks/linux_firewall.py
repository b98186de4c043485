"""Checks whether ufw or firewalld is on; only the administrator can read their rules."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence

from biosensor_common.doctor import firewall_rules, lsl_text, programs
from biosensor_common.doctor.context import Context
from biosensor_common.doctor.finding import Finding, note, ok
from biosensor_common.doctor.firewall_rules import Way

_OPENING: dict[str, Callable[[Sequence[Way]], str]] = {
    "ufw": firewall_rules.ufw,
    "firewalld": firewall_rules.firewalld,
}


def examine(context: Context) -> Iterator[Finding]:
    """Ask systemd."""
    if sys.platform != "linux":
        return
    ports = lsl_text.ports(context.config)
    active = [each for each in _OPENING if programs.succeeds("systemctl", "is-active", each)]
    for name in active:
        yield note(
            f"the firewall {name} is on",
            "Other computers see the streams of this one only if it lets them in: UDP "
            f"{ports.discovery}, and UDP and TCP {ports.first} to {ports.last}.",
            _OPENING[name](firewall_rules.every(ports)),
        )
    if not active:
        yield ok("neither ufw nor firewalld is on, as far as systemd knows")
