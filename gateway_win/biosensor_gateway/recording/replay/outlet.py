"""Offers one recorded stream again."""

from __future__ import annotations

import ctypes
import sys
import xml.etree.ElementTree as ET

import numpy as np
import pylsl
from numpy.typing import NDArray
from pylsl.lib import lib

from biosensor_common.quantities import ChannelFormat
from biosensor_common.replay import Replay, mark_as_replay
from biosensor_gateway.recording.contents.stream import Samples
from biosensor_gateway.recording.replay.errors import ReplayError, ReplayReason
from biosensor_gateway.recording.xdf.header import RecordedHeader

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
    recorded = ET.fromstring(header.xml)  # noqa: S314 - was read before, without a document type
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
    desc = recorded.find("desc")
    root.append(ET.Element("desc") if desc is None else desc)
    mark_as_replay(root[-1], replay)
    return ET.tostring(root, encoding="unicode")


class PlayedOutlet:
    """An outlet like the recorded one; it is on the network from the beginning.

    Raises
    ------
    ReplayError
        ``NO_OUTLET``, if LSL cannot offer it.
    """

    def __init__(self, header: RecordedHeader, source_id: str, replay: Replay) -> None:
        if header.format is ChannelFormat.INT64 and sys.platform == "win32":
            message = f"pylsl cannot send int64 on Windows; leave {header.name!r} out by --streams"
            raise ReplayError(ReplayReason.NO_OUTLET, message)
        try:
            info = _info(played_description(header, source_id, replay))
            self._outlet = pylsl.StreamOutlet(info)
        except RuntimeError as error:
            message = f"LSL cannot offer the stream {header.name!r} ({error})"
            raise ReplayError(ReplayReason.NO_OUTLET, message) from error

    def push(self, samples: Samples, begin: int, end: int, stamps: NDArray[np.float64]) -> None:
        """Send some of the samples.

        Parameters
        ----------
        samples
        begin, end
            Which of them, `end` excluded.
        stamps : ndarray of float64, shape (end - begin,)
            LSL times of now.
        """
        if isinstance(samples.values, list):
            texts = [text for sample in samples.values[begin:end] for text in sample]
            self._outlet.push_chunk(texts, stamps.tolist())
        else:
            self._outlet.push_chunk(samples.values[begin:end], stamps.tolist())

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
