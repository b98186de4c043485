"""Messages between the processes of the node.

Everything but settings is a whole state, so that only the newest counts.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from diagnostic_msgs.msg import DiagnosticStatus
from rcl_interfaces.msg import Parameter

from biosensor_common.spec import DeviceIdentity
from lsl_to_ros.lsl.share import Share
from lsl_to_ros.reports.survey import Part
from lsl_to_ros.topics.register import Claim


@dataclass(frozen=True, slots=True)
class Setup:
    """What a further process starts with: the first thing that it gets.

    Attributes
    ----------
    name, namespace
        Of the node, as users know it.
    parameters
        All that have a value.
    """

    share: Share
    name: str
    namespace: str
    parameters: Sequence[Parameter]


@dataclass(frozen=True, slots=True)
class Settings:
    """Parameters that somebody has set, in the order of time."""

    parameters: Sequence[Parameter]


@dataclass(frozen=True, slots=True)
class AllClaims:
    """The streams of all processes; see :class:`~lsl_to_ros.topics.register.Names`."""

    claims: Mapping[str, Claim]
    lasting: frozenset[DeviceIdentity]


@dataclass(frozen=True, slots=True)
class Claims:
    """The streams of a further process."""

    claims: Mapping[str, Claim]


@dataclass(frozen=True, slots=True)
class Topics:
    """Its part of the list of streams."""

    entries: Sequence[DiagnosticStatus]


@dataclass(frozen=True, slots=True)
class Report:
    """Its part of ``/diagnostics``; an urgent one is not to wait for the next second."""

    part: Part
    is_urgent: bool
