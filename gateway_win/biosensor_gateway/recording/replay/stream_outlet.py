"""Offers one recorded stream as an LSL outlet."""

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
from biosensor_common.stream_header import Replay, mark_as_replay
from biosensor_gateway.recording.contents.stream import Samples
from biosensor_gateway.recording.replay.source import ReplayError, ReplayReason
from biosensor_gateway.recording.xdf.header import RecordedHeader
from biosensor_gateway.recording.xdf.samples import Texts

# Fields about the sending computer. LSL only fills in those that exist, and would keep an old
# address, so they are present but empty.
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
NAMELESS = "nameless"
"""Name of a stream that was recorded without one, which LSL does not offer."""


def played_description(header: RecordedHeader, source_id: str, replay: Replay) -> str:
    """Return the full XML description of a stream to play.

    It is the recorded description with ``desc`` unchanged. At a different speed, the nominal rate
    is scaled to match the timestamps; otherwise receivers would report missing or surplus samples.
    """
    root = ET.Element("info")
    fields = {
        "name": header.name or NAMELESS,
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
    """A block of samples, which is sent in parts."""

    def push(self, begin: int, end: int) -> None:
        """Send the samples from `begin` to before `end`."""
        ...


class _Texts:
    def __init__(self, outlet: LslOutlet, values: Texts, stamps: NDArray[np.float64]) -> None:
        self._outlet, self._values, self._stamps = outlet, values, stamps

    def push(self, begin: int, end: int) -> None:
        texts = [text for sample in self._values[begin:end] for text in sample]
        self._outlet.push_chunk(texts, self._stamps[begin:end].tolist())


class _Numbers:
    """Sends numeric samples by their memory addresses.

    With many streams, looking up the addresses for every sample, as pylsl does, takes longer than
    the push itself.
    """

    def __init__(
        self,
        outlet: LslOutlet,
        values: NDArray[Any],
        stamps: NDArray[np.float64],
        form: ChannelFormat,
    ) -> None:
        self._push, self._outlet = _PUSHES[form], outlet
        # Kept alive as long as their addresses are used.
        self._values, self._stamps = np.ascontiguousarray(values), np.ascontiguousarray(stamps)
        self._values_at, self._stamps_at = self._values.ctypes.data, self._stamps.ctypes.data

    def push(self, begin: int, end: int) -> None:
        count, channels = end - begin, self._values.shape[1]
        # Its only possible error is a number of values that does not fit the channels.
        self._push(
            self._outlet.obj,
            self._values_at + begin * channels * self._values.itemsize,
            count * channels,
            self._stamps_at + begin * self._stamps.itemsize,
            1,
        )
        self._outlet.note_push()


class _Tapped:
    """Passes the samples sent to a callback, too."""

    def __init__(
        self, block: Block, tap: Tap, stamps: NDArray[np.float64], values: NDArray[Any]
    ) -> None:
        self._block, self._tap = block, tap
        self._stamps, self._values = stamps, values

    def push(self, begin: int, end: int) -> None:
        self._block.push(begin, end)
        self._tap(self._stamps[begin:end], self._values[begin:end])


def _push_function(letter: str) -> Callable[..., int]:
    # A function object other than pylsl's, because argument types are declared on it.
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
    """An outlet like the recorded one; it is visible on the network at once.

    Raises
    ------
    ReplayError
        ``NO_OUTLET``, if LSL cannot offer it.
    """

    def __init__(self, header: RecordedHeader, source_id: str, replay: Replay) -> None:
        if header.format is ChannelFormat.INT64 and sys.platform == "win32":
            message = (
                f"pylsl cannot send int64 on Windows; leave {header.title!r} out with --streams"
            )
            raise ReplayError(ReplayReason.NO_OUTLET, message)
        # Called with the timestamps, shape (n,), and values, shape (n, n_channels), that were sent;
        # values of text streams have no channels.
        self.tap: Tap | None = None
        try:
            info = played_info(header, source_id, replay)
            self._outlet, self._format = LslOutlet(info), header.format
        except RuntimeError as error:
            message = f"LSL cannot offer the stream {header.title!r} ({error})"
            raise ReplayError(ReplayReason.NO_OUTLET, message) from error

    def block(self, samples: Samples, stamps: NDArray[np.float64]) -> Block:
        """Return a block that sends samples.

        Parameters
        ----------
        stamps : ndarray of float64, shape (n_samples,)
            LSL times to send.
        """
        if isinstance(samples.values, list):
            block: Block = _Texts(self._outlet, samples.values, stamps)
            shown: NDArray[Any] = np.empty((len(stamps), 0))
        else:
            block = _Numbers(self._outlet, samples.values, stamps, self._format)
            shown = samples.values
        return block if self.tap is None else _Tapped(block, self.tap, stamps, shown)

    def has_receiver(self) -> bool:
        """Whether it has a receiver."""
        return self._outlet.have_consumers()


def played_info(header: RecordedHeader, source_id: str, replay: Replay) -> pylsl.StreamInfo:
    """Return LSL's description of a stream to play.

    Raises
    ------
    RuntimeError
        If LSL does not accept it.
    """
    description = played_description(header, source_id, replay)
    function = lib.lsl_streaminfo_from_xml
    function.restype, function.argtypes = ctypes.c_void_p, (ctypes.c_char_p,)
    info = pylsl.StreamInfo(handle=function(description.encode()))
    if not info.channel_count():
        # On failure, LSL returns the reason in place of the name.
        raise RuntimeError(info.name())
    return info
