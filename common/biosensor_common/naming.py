"""Builds LSL names, source ids and ROS topic names.

Every name is built from fields that people and other programs choose, so each
is escaped: what ROS or LSL forbids becomes ``_xHH``, one for each UTF-8 byte.
Two different fields never give one token, and ordinary ones stay as they are.

A topic's sensor part, ``<sensor>[_<label>]``, is read by people and therefore
plain. It is unique as long as no sensor is named like another one plus a label,
which holds for the built-in sensors. Where it is not unique (a stream of another
program called ``zephyr_left``, or two devices of one kind), :func:`resolve_topics`
gives all of them longer names.

New names of participants have only letters and digits. BIDS labels allow nothing
else, and such names need no change in file names, LSL names and ROS topics. Other
names in existing settings and recordings stay valid; :func:`label` converts them.
"""

from __future__ import annotations

import re
import unicodedata
from collections import Counter
from collections.abc import Hashable, Iterable, Mapping
from dataclasses import dataclass
from hashlib import sha256
from typing import TypeVar

from biosensor_common.errors import ConfigError, ConfigReason
from biosensor_common.known_senders import known_stream
from biosensor_common.spec import DeviceIdentity

# Kept as it is: letters, digits, and an underscore between two of them that does
# not look like the start of an escape.
_FORBIDDEN = re.compile(
    r"(?:(?<![A-Za-z0-9])_|_(?![A-Za-z0-9])|_(?=x[0-9A-F]{2})|[^A-Za-z0-9_])", re.DOTALL
)
_MARKER = "x0"
_TAKEN_SUFFIX = re.compile(r"_(chunk|stamped)\Z")
_TOKEN_LENGTH = 64
_HASH_LENGTH = 16
# Escaped letters never occur in an escaped field, because letters are not escaped.
_HASH_MARK = "_x68"
_FIELD_MARK = "_x75"
_MOST_CHARACTERS = 40
_HASH_CHARACTERS = 6
_NOT_OF_A_LABEL = re.compile(r"[^0-9A-Za-z]+")

Key = TypeVar("Key", bound=Hashable)

AGENT = "gateway"
"""Sensor name of an agent's own streams; their unit is the computer."""
NODE = "lsl_to_ros"
"""Sensor name of a node's own streams; their unit is the computer, too."""
LABEL = re.compile(r"[A-Za-z0-9]+")
"""A BIDS label, see https://bids-specification.readthedocs.io."""
MAX_LENGTH = 32
"""Maximum length of a name that is a part of stream names."""


@dataclass(frozen=True, slots=True)
class TopicName:
    """The topic on which one stream is published.

    Attributes
    ----------
    base
        Relative name of the sensor, ``[<participant>/]<prefix>/<sensor>``, which all topics
        of the device share.
    data
        Last part of the name.
    conflict
        Whether another device would have the same base; then both names include the unit.
    duplicate
        Whether another stream of the same device claims the same name.
    """

    base: str
    data: str
    conflict: bool = False
    duplicate: bool = False

    @property
    def name(self) -> str:
        """The relative topic name."""
        return f"{self.base}/{self.data}"

    def frame_id(self, prefix: str) -> str:
        """Return the sensor's part of the topic, without the prefix: ``p01/zephyr_left``."""
        parts = self.base.split("/")
        before = parts[: len(parts) - len(prefix.split("/") if prefix else []) - 1]
        return "/".join([*before, parts[-1]])


def sanitise(text: str) -> str:
    """Escape any string as one token of a ROS name; different strings give different tokens.

    Letters, digits and single inner underscores stay. Every other byte of the UTF-8 form becomes
    ``_xHH``, and so does an underscore that is doubled, at an end, or would read as the start of
    an escape. A token that does not start with a letter, or starts with ``x0``, gets the prefix
    ``x0``; the empty string becomes ``x0``.

    A token of more than 64 characters is truncated and ends with ``_x68`` and 16 hex digits of its
    SHA-256, so that different long strings stay different.

    Returns
    -------
    str
        ``[A-Za-z][A-Za-z0-9_]*``, at most 64 characters, no ``__``, no ``_`` at its end.
    """
    return _cut(_marked(_escape(text)))


def sensor_topic_name(identity: DeviceIdentity, *, by_unit: bool = False) -> str:
    """Return the topic part of a device: ``<sensor>[_<label>][_<unit>]``.

    Different (sensor, label) pairs give different names if no sensor's name is
    another's followed by an underscore and more; see the module's docstring.
    """
    return _names(identity)[1 if by_unit else 0]


def topic(
    identity: DeviceIdentity, data_name: str, prefix: str = "biosensors", *, by_unit: bool = False
) -> str:
    """Return the relative topic name ``[<participant>/]<prefix>/<sensor>[_<label>]/<data>``.

    Parameters
    ----------
    prefix
        Valid ROS name, used unchanged; left out if empty.
    by_unit
        Append the unit to the sensor: ``zephyr_BHT012345``.
    """
    sensor = sensor_topic_name(identity, by_unit=by_unit)
    return TopicName(_base(identity, sensor, prefix), _data_token(data_name)).name


def resolve_topics(
    streams: Mapping[Key, tuple[DeviceIdentity, str]],
    prefix: str = "biosensors",
    *,
    gone: Iterable[DeviceIdentity] = (),
) -> dict[Key, TopicName]:
    """Assign a topic to every stream, such that no two devices ever share one.

    Devices that would share a name all get the next longer one: first with the unit,
    and if that is not unique either, one that separates every field. The result
    depends only on the set of devices, never on their order.

    Parameters
    ----------
    streams
        Identity and data name by any key, usually the outlet's uid.
    prefix
        As in :func:`topic`.
    gone
        Devices that were present before; no other device gets their names.
    """
    ranks = _ranks({identity for identity, _ in streams.values()}.union(gone))
    claims = Counter(streams.values())
    return {
        key: TopicName(
            base=_base(identity, _names(identity)[ranks[identity]], prefix),
            data=_data_token(data_name),
            conflict=ranks[identity] > 0,
            duplicate=claims[identity, data_name] > 1,
        )
        for key, (identity, data_name) in streams.items()
    }


def lsl_name(identity: DeviceIdentity, data_name: str) -> str:
    """Return an outlet's name, ``[<participant>-]<sensor>[__<label>]-<unit>-<data>``.

    Fields contain neither ``-`` nor ``__``, so all five can be read back. The name
    consists of ASCII letters, digits, ``_`` and ``-``.
    """
    participant = f"{_escape(identity.participant)}-" if identity.participant else ""
    label = f"__{_escape(identity.label)}" if identity.label else ""
    sensor, unit, data = map(_escape, (identity.sensor, identity.unit, data_name))
    return f"{participant}{sensor}{label}-{unit}-{data}"


def source_id(identity: DeviceIdentity, data_name: str) -> str:
    """Return an outlet's source id, by which LSL recovers a stream.

    With a participant or a label it identifies the place on the body, so that a
    replaced strap continues its stream: ``[<participant>@]<sensor>[.<label>]-<data>``.
    Otherwise it identifies the device: ``<sensor>-<unit>-<data>``. It has neither
    quotes nor blanks, which would break LSL queries.
    """
    sensor, data = _escape(identity.sensor), _escape(data_name)
    if not (identity.participant or identity.label):
        return f"{sensor}-{_escape(identity.unit)}-{data}"
    participant = f"{_escape(identity.participant)}@" if identity.participant else ""
    label = f".{_escape(identity.label)}" if identity.label else ""
    return f"{participant}{sensor}{label}-{data}"


def foreign_identity(
    name: str, content_type: str, source_id: str, hostname: str
) -> tuple[DeviceIdentity, str]:
    """Return identity and data name of a stream that another program offers.

    Streams of a :mod:`known program <.known_senders>` get theirs from a table. Otherwise the
    stream's name becomes the sensor, its type (``data`` if empty) the data name, and its source
    id (the host if empty) the unit. Case and characters are kept; :func:`topic` escapes them.
    """
    known = known_stream(name, content_type, source_id, hostname)
    if known is not None:
        return known[1], known[0].data_name
    return DeviceIdentity(sensor=name, unit=source_id or hostname), content_type or "data"


def _escape(text: str) -> str:
    # A lone surrogate cannot be encoded as UTF-8, but a hostile stream may send one.
    one_char_a_byte = text.encode("utf-8", "surrogatepass").decode("latin-1")
    return _FORBIDDEN.sub(lambda match: f"_x{ord(match[0]):02X}", one_char_a_byte)


def _marked(escaped: str) -> str:
    starts_well = escaped[:1].isalpha() and not escaped.startswith(_MARKER)
    return escaped if starts_well else _MARKER + escaped


def _cut(token: str) -> str:
    if len(token) <= _TOKEN_LENGTH:
        return token
    kept = token[: _TOKEN_LENGTH - len(_HASH_MARK) - _HASH_LENGTH].rstrip("_")
    return f"{kept}{_HASH_MARK}{sha256(token.encode()).hexdigest()[:_HASH_LENGTH]}"


def _data_token(data_name: str) -> str:
    """Escape a data name; the suffixes ``_chunk`` and ``_stamped`` are reserved."""
    return _cut(_TAKEN_SUFFIX.sub(r"_x5F\1", _marked(_escape(data_name))))


def _base(identity: DeviceIdentity, sensor: str, prefix: str) -> str:
    participant = sanitise(identity.participant) if identity.participant else ""
    return "/".join(part for part in (participant, prefix, sensor) if part)


def _names(identity: DeviceIdentity) -> tuple[str, str, str]:
    """Return the names of a device, from plain to unique; the last differs from all others."""
    plain = f"{identity.sensor}_{identity.label}" if identity.label else identity.sensor
    fields = (identity.sensor, identity.label, identity.unit)
    return (
        sanitise(plain),
        sanitise(f"{plain}_{identity.unit}"),
        _cut(_marked(_FIELD_MARK.join(_escape(field) for field in fields))),
    )


def _ranks(devices: Iterable[DeviceIdentity]) -> dict[DeviceIdentity, int]:
    """Choose which of its names each device gets: 0 plain, 1 with the unit, 2 unique.

    A name that was ambiguous once is given to no device, so that a subscriber never
    receives another device on a topic that it knows.
    """
    names = {device: _names(device) for device in devices}
    ranks = dict.fromkeys(names, 0)
    while True:
        claims = Counter(
            (device.participant, name)
            for device, rank in ranks.items()
            for name in set(names[device][: rank + 1])
        )
        crowded = [
            device
            for device, rank in ranks.items()
            if rank < 2 and claims[device.participant, names[device][rank]] > 1
        ]
        if not crowded:
            return ranks
        for device in crowded:
            ranks[device] += 1


def label(text: str) -> str:
    """Return the letters and digits of a text, for a BIDS label.

    Accents are removed. A result that is empty or cut gets a hash of the text, so that different
    texts have different labels.
    """
    plain = _plain(text)
    if plain and len(plain) <= _MOST_CHARACTERS:
        return plain
    return plain[: _MOST_CHARACTERS - _HASH_CHARACTERS] + _hash(text)


def require_participant(name: str) -> str:
    """Return a participant's name if it is valid.

    Raises
    ------
    ConfigError
        ``WRONG_VALUE`` if it has other characters than letters and digits, or too many.
    """
    if LABEL.fullmatch(name) and len(name) <= MAX_LENGTH:
        return name
    proposal = _plain(name)[:MAX_LENGTH] or "P01"
    message = (
        f"{name!r} cannot be a participant's name: use 1 to {MAX_LENGTH} letters and digits, "
        f"such as {proposal}"
    )
    raise ConfigError(ConfigReason.WRONG_VALUE, message)


def _plain(text: str) -> str:
    return _NOT_OF_A_LABEL.sub("", unicodedata.normalize("NFKD", text))


def _hash(text: str) -> str:
    return sha256(text.encode("utf-8", "surrogatepass")).hexdigest()[:_HASH_CHARACTERS]
