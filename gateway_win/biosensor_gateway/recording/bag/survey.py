"""Looks a bag through, for what its topics are and where it comes from."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from biosensor_gateway.recording.bag.errors import BagError, BagReason, MessageError
from biosensor_gateway.recording.bag.headers import STAMPED, Facts, listed_facts
from biosensor_gateway.recording.bag.messages import Message, Topic
from biosensor_gateway.recording.bag.opening import read_bag
from biosensor_gateway.recording.bag.recorded_streams import (
    TOPIC,
    RecordedClock,
    RecordedStream,
    read_text,
)
from biosensor_gateway.recording.bag.types import EVENT, SAMPLES, MessageType

# Of ROS itself: they tell of nodes, not of a study.
_OF_ROS = ("/rosout", "/parameter_events")
_LIST_TYPE, _LIST_END = "diagnostic_msgs/msg/DiagnosticArray", "/streams"


@dataclass(slots=True)
class Survey:
    """What is known of a bag before its samples are read.

    Attributes
    ----------
    topics
        Those with messages, by name.
    begin_ns
        Unix time of the earliest message.
    clock, recorded
        Of the recording that it was made of, and its streams by their stamped topics.
    facts
        What the node's list of streams says of those.
    damages
        What cannot be read, a sentence each.
    """

    topics: dict[str, Topic] = field(default_factory=dict[str, Topic])
    begin_ns: int = 0
    clock: RecordedClock | None = None
    recorded: dict[str, RecordedStream] = field(default_factory=dict[str, RecordedStream])
    facts: dict[str, Facts] = field(default_factory=dict[str, Facts])
    damages: list[str] = field(default_factory=list[str])

    @property
    def elsewhere(self) -> frozenset[str]:
        """Topics whose samples are on a stamped one, too, or that have none."""
        names = {TOPIC, *_OF_ROS, *(each for each in self.topics if _is_list(self.topics[each]))}
        for stream in self.recorded.values():
            names.update(stream.topics)
        stamped = {name for name, topic in self.topics.items() if _is_stamped(topic)}
        for name in stamped:
            raw = name.removesuffix(STAMPED)
            names.update((raw, f"{raw}_chunk"))
        return frozenset(names - stamped - self.recorded.keys())

    def guess(self) -> str:
        """Say of which streams the bag tells only what is in their messages; empty if of none."""
        stamped = {name for name, topic in self.topics.items() if _is_stamped(topic)}
        unlisted = sorted(stamped - self.recorded.keys() - self.facts.keys())
        if not unlisted:
            return ""
        more = f" and {len(unlisted) - 1} more" if len(unlisted) > 1 else ""
        return (
            f"{unlisted[0]}{more}: the node's list of streams is not in the bag, so that names, "
            "types, formats and rates of these streams are guesses, and losses cannot be found; "
            "record its topic, too: add |.*/streams to the regex of ros2 bag record"
        )

    def raw_type(self, stamped: str) -> str:
        """Return the type of the raw topic beside a stamped one; empty if it was not recorded."""
        raw = self.topics.get(stamped.removesuffix(STAMPED))
        return "" if raw is None else raw.type_name

    def in_order(self) -> Iterator[Topic]:
        """Give all topics: first those of the recording that it was made of, in its order."""
        for stream in self.recorded.values():
            yield self.topics.get(stream.stamped) or Topic(stream.stamped, SAMPLES)
        for name, topic in self.topics.items():
            if name not in self.recorded:
                yield topic


def survey_bag(path: Path) -> Survey:
    """Look a bag through.

    Raises
    ------
    BagError
        If it cannot be read, or holds no message.
    """
    survey = Survey()
    lists = _Kinds()
    for message in read_bag(path, survey.damages.append):
        topic = message.topic
        if topic.name not in survey.topics:
            survey.topics[topic.name] = topic
            survey.begin_ns = min(survey.begin_ns or message.unix_ns, message.unix_ns)
        if topic.name == TOPIC or _is_list(topic):
            _take(survey, lists, message)
    if not survey.topics:
        why = f": {survey.damages[0]}" if survey.damages else ""
        raise BagError(BagReason.EMPTY, f"{path} holds no message{why}")
    return survey


class _Kinds(dict[Topic, MessageType]):
    """Types by topic, each made once."""

    def __missing__(self, topic: Topic) -> MessageType:
        self[topic] = kind = MessageType(topic)
        return kind


def _take(survey: Survey, kinds: _Kinds, message: Message) -> None:
    """Take in what tells of streams."""
    try:
        read = kinds[message.topic].read(message.content)
        if message.topic.name != TOPIC:
            survey.facts.update(listed_facts(read.status))
            return
        told = read_text(read.data)
    except (AttributeError, MessageError, ValueError) as error:
        survey.damages.append(f"{message.topic.name}: a message cannot be understood ({error})")
        return
    if isinstance(told, RecordedClock):
        survey.clock = told
    else:
        survey.recorded[told.stamped] = told


def _is_stamped(topic: Topic) -> bool:
    return topic.type_name in (SAMPLES, EVENT)


def _is_list(topic: Topic) -> bool:
    return topic.type_name == _LIST_TYPE and topic.name.endswith(_LIST_END)
