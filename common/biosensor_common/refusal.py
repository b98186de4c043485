"""Reports data that the programs drop, change, duplicate, rename or guess.

All code that does so reports a member of `Refusal` by `Refusals.refuse`; a test finds code that
does not (``tests/refusals``). Reports are shown with a level above OK in ``/diagnostics``, in
``status`` and on the page.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from enum import Enum, IntEnum, unique

_NOUNS = ("samples", "messages", "streams")


class Level(IntEnum):
    """Severity, with the numbers of ``/diagnostics``, where 0 is OK."""

    WARN = 1
    ERROR = 2


_ERROR = Level.ERROR
_Told = tuple[str, Level, str, bool]


def _standing(word: str, sentence: str, level: Level = Level.WARN) -> _Told:
    return word, level, sentence, True


def _passing(word: str, sentence: str) -> _Told:
    return word, Level.WARN, sentence, False


@unique
class Refusal(Enum):
    """One kind of data that is not passed on unchanged.

    Attributes
    ----------
    word
        Stable identifier for programs.
    sentence
        Template with placeholders: ``count``; ``samples``, ``messages`` or ``streams``, replaced by
        the count and the noun; ``are`` and ``were``, which agree with the count; and facts of the
        report.
    stands
        Whether it lasts until it is reported to be over; otherwise it is shown for some seconds.
    """

    # Streams and topics that are left out or may be confused.
    UNUSABLE = _standing("unusable", "it is ignored: {why}")
    NO_FILES = _standing("no_files", "it is left out: {why}")
    NO_DESCRIPTION = _standing(
        "no_description",
        "{why}; it is published as a stream of an unknown program",
    )
    SAME_SOURCE = _standing(
        "same_source",
        "another sender has the same source_id, name and type; that on {hosts} is not published: "
        "give each sender its own source_id",
        _ERROR,
    )
    SECOND_SENDER = _standing(
        "second_sender",
        "{senders} senders have the same source_id, name and type, on {hosts}; each has its own "
        "topic, in the order of their starts: give each its own source_id",
    )
    EITHER_SENDER = _standing(
        "either_sender",
        "another stream has the same source_id: programs that look for it may take either",
    )
    TWO_UNITS = _standing(
        "two_units",
        "two units of one sensor: give each a label in its settings",
        _ERROR,
    )
    TWO_STREAMS = _standing("two_streams", "two streams claim to be this one", _ERROR)
    NO_TOPIC = _standing("no_topic", "{why}; the LSL stream {name!r} is not published", _ERROR)
    NO_STANDARD_TOPIC = _standing(
        "no_standard_topic",
        "there is no additional topic {topic} of sensor_msgs: another stream of the device has"
        " that name",
    )
    FORMAT_CHANGED = _passing("format_changed", "the stream was restarted as {shape}")
    DOUBLED = _standing(
        "doubled",
        "another node also publishes this topic: each sample is duplicated",
        _ERROR,
    )
    MAYBE_DOUBLED = _standing(
        "maybe_doubled",
        "another node also publishes this topic, or was killed less than half a minute ago",
    )
    READ_IN_VAIN = _standing("read_in_vain", "a subscriber gets nothing: {why}")
    NODE_TWICE = _standing(
        "node_twice",
        "two nodes of this name are running: each sample is published twice; end one of "
        "them, or give one a different topic_prefix and name",
        _ERROR,
    )
    NODE_MAYBE_TWICE = _standing(
        "node_maybe_twice",
        "another node of this name is known to DDS: it is also running, or was killed less than "
        "half a minute ago",
    )
    NO_STAMPED_TOPICS = _standing(
        "no_stamped_topics",
        "biosensor_msgs is not installed: there are no _stamped topics; build it with colcon",
    )
    NOT_LISTED = _standing("not_listed", "{streams} {are} not listed: the limit is {most}")

    # Samples and messages on their way.
    UNFIT = _passing("unfit", "{samples} {were} not published: {why}")
    NO_TIME = _passing("no_time", "{samples} {are} not on a stamped topic: {why}")
    UNSTAMPED = _passing(
        "unstamped",
        "{samples} {were} dropped: the sender's clock remained unknown; is UDP blocked?",
    )
    CHUNK_CUT = _passing(
        "chunk_cut",
        "{samples} of an unfinished chunk {are} on the raw topic only",
    )
    UNDELIVERED = _passing("undelivered", "{samples} {were} lost with the connection")
    READ_FAILED = _passing("read_failed", "reading failed, so it is opened again ({why})")
    NOT_JOINED = _passing(
        "not_joined", "{samples} {were} published without {columns}: {stream} did not provide them"
    )
    UNSENT = _passing("unsent", "ROS has not published {messages} ({why})")
    NO_COUNTS = _passing(
        "no_counts",
        "the agent's counts cannot be read ({why}), so losses are unknown",
    )
    SIMULATED_TIME = _standing(
        "simulated_time",
        "use_sim_time is on: _stamped topics have the simulated time at which samples arrived, "
        "which is 0 without /clock, instead of when they were measured; switch it off for this "
        "node",
    )
    UNIX_STAMPS = _standing(
        "unix_stamps",
        "its timestamps are Unix times, not times of the LSL clock: _stamped topics have them "
        "unchanged, and recordings cannot align them; push samples without a timestamp, or with "
        "local_clock()",
    )
    FOREIGN_STAMPS = _standing("foreign_stamps", "its timestamps are not times of the LSL clock")
    UNKNOWN_CLOCK = _standing(
        "unknown_clock",
        "the sender's clock cannot be queried: is UDP blocked? stamped topics are delayed",
    )
    BY_ARRIVAL = _standing(
        "by_arrival",
        "its timestamps are of another clock; its samples are shown when they arrive",
    )

    # Topics that become streams.
    NOT_SENT = _standing("not_sent", "{why}; it is not sent", _ERROR)
    NO_PUBLISHER = _standing("no_publisher", "nothing publishes it {since}{hint}")
    NO_NUMBER = _standing("no_number", "no numbers yet: its messages contained none")
    OTHER_TYPE = _standing("other_type", "{types} is also published on it; only {sent} is sent")
    MIXED = _standing(
        "mixed",
        "{publishers} publishers of it are known: their messages are mixed in one stream, and "
        "how many are lost on the way is unknown; give each its own topic",
    )
    SENT_TWICE = _standing(
        "sent_twice",
        "another ros_to_lsl also sends it, or was killed less than half a minute ago: recordings "
        "have each message twice; end one of them, or, if it sends another robot's topic, give one "
        "of the streams another name (parameter /topic.name)",
    )
    SAME_NAME = _standing(
        "same_name",
        "another ros_to_lsl, on {hosts}, sends a different stream of the name {names}: only a "
        "number tells them apart in exports; give one of them another name (parameter /topic.name)",
    )
    NEW_CHANNELS = _passing(
        "new_channels",
        "its sequences have changed: {channels} channels now; the stream {name} continues as a "
        "new one, which a running recording may not contain",
    )
    ROUNDED = _standing(
        "rounded",
        "{label} has integers above 2**53, which are rounded to a 64-bit float",
    )
    TOO_MANY_PAIRS = _standing(
        "too_many_pairs",
        "it has more than {most} pairs of frames; the others are not sent: send it as JSON, "
        "which contains all of them",
    )
    CUT = _passing(
        "cut",
        "{messages} {were} cut at a NUL character, which text in LSL cannot contain",
    )
    SEND_FAILED = _passing("send_failed", "{messages} could not be sent: {why}")
    LOST_ON_THE_WAY = _passing(
        "lost_on_the_way",
        "{messages} {were} lost on the way from its publisher",
    )
    NOT_SMALL = _standing(
        "not_small",
        "all_small leaves out {topics}: bulk data (images, point clouds and the like), or"
        " a type that is not installed here; record them with ros2 bag",
    )
    DOUBTFUL_STAMPS = _standing("doubtful_stamps", "{why}")
    DOUBTFUL_CLOCK = _standing("doubtful_clock", "{why}")

    # Samples on their way from a device to LSL.
    WRONG_SHAPE = _passing(
        "wrong_shape",
        "{samples} {were} refused: shape {shape} instead of {expected}",
    )
    BACKWARDS = _passing("backwards", "{samples} {were} refused: timestamps run backwards")
    NOT_LSL_TIME = _passing(
        "not_lsl_time",
        "{samples} {were} refused: timestamps are not on the LSL clock",
    )
    INFINITE = _passing("infinite", "{samples} {were} refused: infinite values")
    NO_VALUE = _passing("no_value", "{samples} {were} refused: no value in {kind} stream")
    OUT_OF_RANGE = _passing(
        "out_of_range",
        "{samples} {were} refused: values outside {low}..{high}",
    )
    IMPLAUSIBLE = _passing("implausible", "{samples} {were} not sent: {why}")
    FLAT = _standing(
        "flat",
        "{channels} not changed for {limit_s:g} s or longer, so this is not a body signal: check "
        "electrode, contact with the skin, cable, and the settings of the device",
    )
    PAUSED = _passing("paused", "{samples} {were} suppressed because of a pause")
    WAITED_TOO_LONG = _passing(
        "waited_too_long",
        "{samples} {were} dropped: the stream had no receiver, and at most {most} samples are "
        "buffered",
    )
    LEFT_OUT = _passing("left_out", "{samples} {were} left out: {why}")
    LATE = _passing(
        "late",
        "{samples} had been delayed with others and {are} stamped on arrival, up to "
        "{seconds:.1f} s late: the device sends no timestamps for them",
    )
    GARBLED = _passing("garbled", "{count} bytes of the device were not part of a valid message")
    NO_OUTLET = _standing(
        "no_outlet",
        "there is no stream for {name}, so none of its data is sent",
        _ERROR,
    )
    UNHEARD_MARKER = _passing(
        "unheard_marker",
        "a marker was sent without a receiver: no program records the markers",
    )

    # Features of streams.
    FEATURES_ENDED = _passing(
        "features_ended",
        "live features had ended ({why}) and were started again: a part is missing",
    )
    NO_FEATURES = _standing("no_features", "{why}")
    FEATURES_TWICE = _standing(
        "features_twice",
        "another program, on {hosts}, also sends its features, so each value is there twice: end "
        "one of them",
    )
    WRONG_RATE = _standing("wrong_rate", "{why}")
    STAMPS_LEFT_OUT = _passing("stamps_left_out", "{why}")
    NO_FINITE_VALUE = _passing(
        "no_finite_value",
        "{samples} {were} left out: their values are infinite or implausibly large",
    )

    def __init__(self, word: str, level: Level, sentence: str, stands: bool) -> None:
        self.word = word
        self.level = level
        self.sentence = sentence
        self.stands = stands

    def message(self, /, count: int = 1, **facts: object) -> str:
        """Return the sentence with its placeholders filled in."""
        is_one = count == 1
        nouns = {each: f"{count} {each[: -1 if is_one else None]}" for each in _NOUNS}
        verbs = {"are": "is" if is_one else "are", "were": "was" if is_one else "were"}
        return self.sentence.format(**{"count": count, **nouns, **verbs, **facts})

    def cause(self, **facts: object) -> str:
        """Return the part of the sentence after the colon."""
        return self.message(1, **facts).partition(": ")[2]


LATELY_S = 10.0
"""How long a report that does not last is shown after its latest occurrence."""
AGAIN_S = 60.0
"""After this time the log repeats a report that still occurs."""
_MOST = 1000
"""Limit of remembered reports, because names from the network may be unlimited."""


@dataclass(frozen=True, slots=True)
class Refused:
    """The reports of one kind about one stream or topic.

    Attributes
    ----------
    about
        Its stream or topic; empty if the reporter has only one.
    count
        Total number of samples, messages or streams, according to the sentence.
    first_s, last_s
        Times on the clock of the `Refusals`.
    is_over
        Whether it lasted and has ended.
    """

    what: Refusal
    about: str
    count: int
    first_s: float
    last_s: float
    facts: Mapping[str, object] = field(default_factory=dict[str, object])
    is_over: bool = False

    @property
    def sentence(self) -> str:
        """The sentence for the user."""
        return self.what.message(self.count, **self.facts)

    @property
    def sentence_about(self) -> str:
        """The sentence, preceded by its stream or topic."""
        return f"{self.about}: {self.sentence}" if self.about else self.sentence


class Refusals:
    """Reports of data that was not passed on unchanged; any thread may report.

    Parameters
    ----------
    say
        Called with a sentence for the log: once per report, and again if it returns after a while.
    about
        Subject of the sentences for the log.
    clock
        In seconds.
    again_s
        After how many seconds the log repeats a report; one that lasts is logged once.
    """

    def __init__(
        self,
        say: Callable[[str], object] | None = None,
        about: str = "",
        clock: Callable[[], float] = time.monotonic,
        again_s: float = AGAIN_S,
    ) -> None:
        self._say, self._about, self._clock, self._again_s = say, about, clock, again_s
        self._said: dict[tuple[Refusal, str], float] = {}
        self._lock = threading.Lock()
        self._told: dict[tuple[Refusal, str], Refused] = {}

    def refuse(self, what: Refusal, count: int = 1, *, about: str = "", **facts: object) -> None:
        """Report that data was not passed on unchanged; the newest facts are kept."""
        now = self._clock()
        with self._lock:
            before = self._told.pop((what, about), None)
            first_s = before.first_s if before else now
            total = count if before is None or what.stands else before.count + count
            told = Refused(what, about, total, first_s, now, facts)
            # Moved to the end, so that the oldest reports are at the front and are forgotten first.
            self._told[what, about] = told
            if len(self._told) > _MOST:
                oldest = next(iter(self._told))
                del self._told[oldest]
                self._said.pop(oldest, None)
            is_to_say = self._is_to_say(what, about, before, now)
        if self._say is not None and is_to_say:
            whose = about or self._about
            sentence = what.message(count, **facts)
            self._say(f"{whose}: {sentence}" if whose else sentence)

    def _is_to_say(self, what: Refusal, about: str, before: Refused | None, now: float) -> bool:
        is_due = now - self._said.get((what, about), -math.inf) > self._again_s
        is_new = before is None or before.is_over
        if not (is_new or (is_due and not what.stands)):
            return False
        self._said[what, about] = now
        return True

    def over(self, what: Refusal, about: str = "") -> None:
        """Report that something lasting has ended."""
        with self._lock:
            told = self._told.get((what, about))
            if told is not None and not told.is_over:
                self._told[what, about] = replace(told, is_over=True)

    def hold(
        self,
        what: Refusal,
        is_so: bool,
        count: int = 1,
        *,
        about: str = "",
        **facts: object,
    ) -> None:
        """Report whether something lasting is the case now."""
        if is_so:
            self.refuse(what, count, about=about, **facts)
        else:
            self.over(what, about)

    def count(self, *what: Refusal) -> int:
        """Return the total count of these kinds."""
        return sum(each.count for each in self.all if each.what in what)

    @property
    def all(self) -> list[Refused]:
        """Return all remembered reports, the latest at the end."""
        with self._lock:
            return list(self._told.values())

    @property
    def present(self) -> list[Refused]:
        """Return lasting reports and those of the last seconds, the most severe first."""
        return self.within(LATELY_S)

    def within(self, lately_s: float) -> list[Refused]:
        """Return lasting reports and those of this many seconds, the most severe first."""
        # Asked for each stream once a second, and most have none.
        if not self._told:
            return []
        now = self._clock()
        shown = [
            each
            for each in self.all
            if not each.is_over and (each.what.stands or now - each.last_s <= lately_s)
        ]
        return sorted(shown, key=lambda each: -each.what.level)
