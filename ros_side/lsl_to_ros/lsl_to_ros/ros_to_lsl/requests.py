"""The topics that are to be sent, and how."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum, unique


@unique
class SendAs(StrEnum):
    """What becomes of a topic's messages."""

    AUTO = ""
    """Numbers are samples, and text beside them markers when it changes; else markers."""
    SAMPLES = "samples"
    MARKERS = "markers"
    """Each message is one marker: its only field, or all of it as JSON."""
    JSON = "json"
    """Each message is one marker, all of it as JSON."""


@dataclass(frozen=True, slots=True)
class TopicRequest:
    """What the parameters say of one topic.

    Attributes
    ----------
    topic
        Full name.
    name
        Of the stream.
    fields
        Which of the message's; all if there is none.
    rate
        Nominal, in Hz; 0 for an irregular stream.
    type_name
        Of the message, if it was said; else the publishers say it.
    """

    topic: str
    name: str
    send_as: SendAs = SendAs.AUTO
    fields: tuple[str, ...] = ()
    rate: float = 0.0
    type_name: str = ""


@dataclass(frozen=True, slots=True)
class Requests:
    """What the parameters say in all.

    Attributes
    ----------
    all_small
        Send every other topic, too, but those with bytes without a limit.
    by_arrival
        Stamp everything by the time of its arrival.
    """

    topics: tuple[TopicRequest, ...] = ()
    all_small: bool = False
    by_arrival: bool = False


def stream_name(topic: str) -> str:
    """Return a stream's name for a topic: ``robot-odom`` for ``/robot/odom``.

    Topics have no hyphen, so different ones have different names.
    """
    return topic.strip("/").replace("/", "-")
