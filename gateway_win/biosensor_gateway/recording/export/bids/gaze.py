"""Finds the eyes of a gaze stream: BIDS wants a table per eye, with x and y first.

They are recognised by channel types in the header
(https://github.com/sccn/xdf/wiki/Gaze-Meta-Data), or else by labels such as ``left_gaze_x``,
``norm_pos_y`` or ``Gaze X``.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from biosensor_common.errors import SpecError
from biosensor_gateway.recording.contents.stream import Samples, Stream
from biosensor_gateway.recording.export.bids import sidecars
from biosensor_gateway.recording.export.bids.file_names import NOTHING
from biosensor_gateway.recording.export.tables import unique

X, Y, PUPIL = "x_coordinate", "y_coordinate", "pupil_size"
_WORD = re.compile(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])|\d+")
_EYES = {"left": "left", "l": "left", "right": "right", "r": "right"}
_SIZES = {"diam": "diameter", "area": "area"}
_SIZE = re.compile("|".join(_SIZES))
# Words allowed in the name of a gaze position; any other word means a different vector.
_OF_GAZE = frozenset(
    {"gaze", "screen", "por", "norm", "pos", "position", "point", "on", "display", "area", "eye"}
    | {"both", "combined", "coordinate", "px", "pixel", "2", "d", *_EYES}
)


@dataclass(frozen=True, slots=True)
class Eye:
    """The channels of one eye in a stream."""

    recorded: str  # `left`, `right`, or `cyclopean` of both together.
    is_told: bool  # Whether the header specifies the eye.
    # places, names: its channels in the stream and the names of their columns, x and y first.
    places: tuple[int, ...]
    names: tuple[str, ...]

    def picked(self, parts: Iterator[Samples]) -> Iterator[Samples]:
        """Yield samples with only its channels."""
        for samples in parts:
            yield replace(samples, values=np.asarray(samples.values)[:, self.places])

    def described(self, stream: Stream) -> dict[str, object]:
        """Return the sidecar entries specific to gaze."""
        by_place = list(sidecars.described_columns(stream).values())
        kinds = sidecars.channel_types(stream)
        columns: dict[str, dict[str, str]] = {}
        for place, name in zip(self.places, self.names, strict=True):
            usual = {"Units": NOTHING} if name in (X, Y) else {}
            columns[name] = usual | by_place[place]
            size = _SIZE.search(f"{stream.header.labels[place]} {kinds[place]}".lower())
            if name == PUPIL and size:
                columns[name]["Description"] += f", its {_SIZES[size[0]]}"
        system, told = _coordinate_system(stream)
        return {
            "PhysioType": "eyetrack",
            "RecordedEye": self.recorded,
            "SampleCoordinateSystem": system,
            "SampleCoordinateSystemDescription": told,
            **columns,
        }


def eyes_of(stream: Stream) -> list[Eye]:
    """Return the eyes of a gaze stream; none if x and y are unknown."""
    nodes = _channels(stream)
    found = [
        _meaning(label, *told) for label, told in zip(stream.header.labels, nodes, strict=True)
    ]
    names = sidecars.columns(stream)
    eyes: list[Eye] = []
    for side in ("left", "right", ""):
        own = {what: place for place, (what, of) in reversed([*enumerate(found)]) if of == side}
        if X not in own or Y not in own:
            continue
        first = [own[each] for each in (X, Y, PUPIL) if each in own]
        rest = [place for place, (_, of) in enumerate(found) if of == side and place not in first]
        called = [each for each in (X, Y, PUPIL) if each in own]
        called += [names[place] for place in rest]
        eyes.append(Eye(side or "cyclopean", bool(side), (*first, *rest), tuple(unique(called))))
    return _with_the_others(eyes, names)


def _with_the_others(eyes: list[Eye], names: Sequence[str]) -> list[Eye]:
    """Add channels that belong to no eye with a table to the first one."""
    taken = {place for each in eyes for place in each.places}
    others = [place for place in range(len(names)) if place not in taken]
    if eyes and others:
        first = eyes[0]
        called = unique([*first.names, *(names[place] for place in others)])
        eyes[0] = replace(first, places=(*first.places, *others), names=tuple(called))
    return eyes


def _meaning(label: str, kind: str, eye: str) -> tuple[str, str]:
    """Return the meaning of a channel, empty if unknown, and its eye."""
    words = [each.lower() for each in _WORD.findall(label)]
    side = _EYES.get(eye.lower(), "")
    if not side and not eye:
        side = next((_EYES[each] for each in words if each in _EYES), "")
    by_type = {"screenx": X, "screeny": Y, "diameter": PUPIL, "pupildiameter": PUPIL}
    if what := by_type.get("".join(_WORD.findall(kind)).lower()):
        return what, side
    axes = [each for each in words if each in ("x", "y", "z")]
    if len(axes) == 1 and axes[0] != "z" and _OF_GAZE.issuperset(set(words) - {axes[0]}):
        return (X if axes[0] == "x" else Y), side
    if not axes and ("pupil" in words or "diameter" in words):
        return PUPIL, side
    return "", side


def _channels(stream: Stream) -> list[tuple[str, str]]:
    """Return type and eye of each channel from the header."""
    try:
        nodes = stream.header.parsed().findall("desc/channels/channel")
    except SpecError:
        nodes = []
    if len(nodes) != stream.header.channel_count:
        return [("", "")] * stream.header.channel_count
    return [
        ((each.findtext("type") or "").strip(), (each.findtext("eye") or "").strip())
        for each in nodes
    ]


def _coordinate_system(stream: Stream) -> tuple[str, str]:
    """Return the BIDS coordinate system, and the header's description of it."""
    # Gaze on a screen would need the size and distance of the screen, which LSL headers do not
    # contain.
    try:
        told = {each.text or "" for each in stream.header.parsed().iter("coordinate_system")}
    except SpecError:
        told = set[str]()
    text = ", ".join(sorted(each.strip() for each in told if each.strip()))
    if "world" in text.lower():
        return "gaze-in-world", text
    return "custom", text or "as the sender sends it; the header only has units and labels"
