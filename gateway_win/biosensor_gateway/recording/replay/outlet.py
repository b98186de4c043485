"""Offers one recorded stream again."""

from __future__ import annotations

import ctypes
import sys
import xml.etree.ElementTree as ET
from collections.abc import Callable
from typing import Any, Protocol

import numpy as np
import pylsl
from numpy.typing import NDArray
from pylsl.lib import lib

from biosensor_common.lsl.outlet import LslOutlet
from biosensor_common.quantities import ChannelFormat
from biosensor_common.replay import Replay, mark_as_replay
from biosensor_gateway.recording.contents.stream import Samples
from biosensor_gateway.recording.replay.source import ReplayError, ReplayReason
from biosensor_gateway.recording.xdf.header import RecordedHeader
from biosensor_gateway.recording.xdf.samples import Texts

# The fields of this computer. LSL puts its own texts in place of these, but only where one is;
# an address that is not empty it would believe.
_BLANK = {
    "version": "1.1",
    "created_at": "0",
    "uid": "none",
    "session_id": "none",
    "hostname": "none",
    "v4address": "",
    "v4data_port": "0",
    "v4service_port": "0",
    "v6address": "",
    "v6data_port": "0",
    "v6service_port": "0",
}


def played_description(header: RecordedHeader, source_id: str, replay: Replay) -> str:
    """Return the full description of a stream that is to be played, as XML.

    It is the recorded one, with everything in ``desc`` as it was. At another speed the nominal
    rate is that of the stamps, else every receiver would miss samples, or find too many.
    """
    root = ET.Element("info")
    fields = {
        "name": header.name,
        "type": header.content_type,
        "channel_count": str(header.channel_count),
        "channel_format": header.format.value,
        "source_id": source_id,
        "nominal_srate": repr(header.rate * replay.speed),
    }
    for name, text in (fields | _BLANK).items():
        ET.SubElement(root, name).text = text
    desc = header.parsed().find("desc")
    root.append(ET.Element("desc") if desc is None else desc)
    mark_as_replay(root[-1], replay)
    return ET.tostring(root, encoding="unicode")


Tap = Callable[[NDArray[np.float64], NDArray[Any]], None]
"""See :attr:`PlayedOutlet.tap`."""


class Block(Protocol):
    """Some samples of a stream, which go out part by part."""

    def push(self, begin: int, end: int) -> None:
        """Send some of them, `end` excluded."""
        ...


class _Texts:
    def __init__(self, outlet: LslOutlet, values: Texts, stamps: NDArray[np.float64]) -> None:
        self._outlet, self._values, self._stamps = outlet, values, stamps

    def push(self, begin: int, end: int) -> None:
        texts = [text for sample in self._values[begin:end] for text in sample]
        self._outlet.push_chunk(texts, self._stamps[begin:end].tolist())


class _Numbers:
    """Keeps where samples stand in memory.

    To find that out with each sample of each of many streams, as pylsl does, takes longer than LSL
    takes to take them in.
    """

    def __init__(
        self,
        outlet: LslOutlet,
        values: NDArray[Any],
        stamps: NDArray[np.float64],
        form: ChannelFormat,
    ) -> None:
        self._push, self._outlet = _PUSHES[form], outlet
        # They stay as long as their addresses are used.
        self._values, self._stamps = np.ascontiguousarray(values), np.ascontiguousarray(stamps)
        self._values_at, self._stamps_at = self._values.ctypes.data, self._stamps.ctypes.data

    def push(self, begin: int, end: int) -> None:
        count, channels = end - begin, self._values.shape[1]
        # It has no error but that of a number of values that are no samples.
        self._push(
            self._outlet.obj,
            self._values_at + begin * channels * self._values.itemsize,
            count * channels,
            self._stamps_at + begin * self._stamps.itemsize,
            1,
        )
        self._outlet.note_push()


class _Tapped:
    """Shows what is sent to somebody else, too."""

    def __init__(
        self, block: Block, tap: Tap, stamps: NDArray[np.float64], values: NDArray[Any]
    ) -> None:
        self._block, self._tap = block, tap
        self._stamps, self._values = stamps, values

    def push(self, begin: int, end: int) -> None:
        self._block.push(begin, end)
        self._tap(self._stamps[begin:end], self._values[begin:end])


def _push_function(letter: str) -> Callable[..., int]:
    # Not the one that pylsl uses: it knows no types of arguments.
    function = lib[f"lsl_push_chunk_{letter}tnp"]
    pointer = ctypes.c_void_p
    function.argtypes = (pointer, pointer, ctypes.c_ulong, pointer, ctypes.c_int32)
    return function


_PUSHES = {
    ChannelFormat.FLOAT32: _push_function("f"),
    ChannelFormat.DOUBLE64: _push_function("d"),
    ChannelFormat.INT64: _push_function("l"),
    ChannelFormat.INT32: _push_function("i"),
    ChannelFormat.INT16: _push_function("s"),
    ChannelFormat.INT8: _push_function("c"),
}


class PlayedOutlet:
    """An outlet like the recorded one; it is on the network from the beginning.

    Attributes
    ----------
    tap
        Is given stamps, shape (n,), and values, shape (n, n_channels), of what was sent; of text
        there are no channels.

    Raises
    ------
    ReplayError
        ``NO_OUTLET``, if LSL cannot offer it.
    """

    def __init__(self, header: RecordedHeader, source_id: str, replay: Replay) -> None:
        if header.format is ChannelFormat.INT64 and sys.platform == "win32":
            message = f"pylsl cannot send int64 on Windows; leave {header.name!r} out by --streams"
            raise ReplayError(ReplayReason.NO_OUTLET, message)
        self.tap: Tap | None = None
        try:
            info = _info(played_description(header, source_id, replay))
            self._outlet, self._format = LslOutlet(info), header.format
        except RuntimeError as error:
            message = f"LSL cannot offer the stream {header.name!r} ({error})"
            raise ReplayError(ReplayReason.NO_OUTLET, message) from error

    def block(self, samples: Samples, stamps: NDArray[np.float64]) -> Block:
        """Return what sends samples.

        Parameters
        ----------
        stamps : ndarray of float64, shape (n_samples,)
            LSL times of now.
        """
        if isinstance(samples.values, list):
            block: Block = _Texts(self._outlet, samples.values, stamps)
            shown: NDArray[Any] = np.empty((len(stamps), 0))
        else:
            block = _Numbers(self._outlet, samples.values, stamps, self._format)
            shown = samples.values
        return block if self.tap is None else _Tapped(block, self.tap, stamps, shown)

    def has_receiver(self) -> bool:
        """Whether anybody receives it."""
        return self._outlet.have_consumers()


def _info(description: str) -> pylsl.StreamInfo:
    function = lib.lsl_streaminfo_from_xml
    function.restype, function.argtypes = ctypes.c_void_p, (ctypes.c_char_p,)
    info = pylsl.StreamInfo(handle=function(description.encode()))
    if not info.channel_count():
        # LSL says why in place of the name.
        raise RuntimeError(info.name())
    return info
