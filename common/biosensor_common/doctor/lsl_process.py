"""The LSL process of a check, with its own configuration; see `probe`.

Offers a stream, searches for one or all streams, and receives from them.
"""

from __future__ import annotations

import ctypes
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict
from functools import partial
from typing import Any, NoReturn
from xml.etree import ElementTree as ET

import pylsl
from pylsl.lib import lib

from biosensor_common.doctor.probe import SurveyedStream, answer, serve
from biosensor_common.errors import SpecError
from biosensor_common.lsl.inlet import unopened_inlet
from biosensor_common.lsl.network import search
from biosensor_common.lsl.predicates import IN_ANY_SESSION, equals
from biosensor_common.lsl_header import read_xml

MAX_EXAMINED = 256
"""Largest number of streams to receive from; all are listed."""
_PERIOD_S = 0.1
_THREADS = 64
_MAX_HEADER = 100_000
_DATA_PORT = "v4data_port"
_PORTS = (_DATA_PORT, "v4service_port", "v6data_port", "v6service_port")
_FORMATS = {
    pylsl.cf_float32: "float32",
    pylsl.cf_double64: "double64",
    pylsl.cf_string: "string",
    pylsl.cf_int32: "int32",
    pylsl.cf_int16: "int16",
    pylsl.cf_int8: "int8",
    pylsl.cf_int64: "int64",
}


def main() -> None:
    """Run the request from stdin."""
    roles: dict[str, Callable[..., object]] = {
        "offer": _offer,
        "find": _find,
        "survey": survey,
        "list": list_streams,
        "meet": meet,
    }
    serve({name: partial(_configured, role) for name, role in roles.items()})


def _configured(role: Callable[..., object], config: str, **request: object) -> object:
    """Run a role with its own configuration of LSL."""
    pylsl.set_config_content(config)
    return role(**request)


def _offer(source_id: str) -> NoReturn:
    """Offer a stream and send samples until this process is ended."""
    outlet = pylsl.StreamOutlet(pylsl.StreamInfo(source_id, "Doctor", 1, 0.0, "float32", source_id))
    answer({"open": True})
    while True:
        outlet.push_sample([0.0])
        time.sleep(_PERIOD_S)


def _find(source_id: str, timeout_s: float) -> dict[str, Any]:
    """Search for a stream."""
    return {"found": bool(pylsl.resolve_bypred(equals("source_id", source_id), 1, timeout_s))}


def survey(search_s: float, listen_s: float, listen_until_s: float) -> dict[str, Any]:
    """Search for streams for *search_s*, then receive from each of them.

    Each step of receiving may take *listen_s*; after *listen_until_s* no step is started.

    Returns
    -------
    dict
        ``streams``, each as a `SurveyedStream`, and ``elsewhere``: streams of other sessions
        with the same source_ids.
    """
    deadline_s = time.monotonic() + listen_until_s
    of_all_sessions = pylsl.ContinuousResolver(pred=IN_ANY_SESSION, forget_after=60.0)
    infos = _found(search_s)
    seen = [_described(info) for info in infos]
    examined = min(len(infos), MAX_EXAMINED)
    with ThreadPoolExecutor(_THREADS) as pool:
        for info, each in zip(infos[:examined], seen[:examined], strict=True):
            pool.submit(_listen, info, each, listen_s, deadline_s)
    every = [_described(info) for info in of_all_sessions.results()]
    return {
        "streams": [asdict(each) for each in seen],
        "elsewhere": [asdict(each) for each in _claimed(seen, every)],
    }


def _claimed(
    seen: Sequence[SurveyedStream], every: Sequence[SurveyedStream]
) -> list[SurveyedStream]:
    sessions = {each.session for each in seen}
    source_ids = {each.source_id for each in seen} - {""}
    return [each for each in every if each.session not in sessions and each.source_id in source_ids]


def list_streams(search_s: float) -> dict[str, Any]:
    """Search for streams; return ``streams`` as `survey` does, without receiving from them."""
    return {"streams": [asdict(_described(info)) for info in _found(search_s)]}


def _found(search_s: float) -> list[pylsl.StreamInfo]:
    return search(lambda _found, elapsed_s: elapsed_s >= search_s)


def meet(source_id: str, search_s: float, listen_s: float) -> dict[str, Any]:
    """Search for one stream, and receive from it.

    Returns
    -------
    dict
        ``found``, and for a stream that was found: ``received`` (whether a sample came),
        ``address`` (of its sender; empty without a sample), and ``offset_s`` and
        ``round_trip_s`` as in a `SurveyedStream`.
    """
    infos = pylsl.resolve_bypred(equals("source_id", source_id), 1, search_s)
    if not infos:
        return {"found": False}
    seen = _described(infos[0])
    inlet = unopened_inlet(infos[0])
    _measure_clock(inlet, seen, listen_s)
    received = _has_sample(inlet, listen_s)
    return {
        "found": True,
        "received": received,
        "address": _peer(seen.ports) if received else "",
        "offset_s": seen.offset_s,
        "round_trip_s": seen.round_trip_s,
    }


def _has_sample(inlet: pylsl.StreamInlet, limit_s: float) -> bool:
    try:
        inlet.open_stream(limit_s)
        _, stamp = inlet.pull_sample(limit_s)
    except RuntimeError:
        return False
    return stamp is not None


def _peer(ports: Sequence[int]) -> str:
    """Return the address to which this process is connected; liblsl does not report it."""
    import psutil

    connections = psutil.Process().net_connections("tcp")
    found = (each.raddr.ip for each in connections if each.raddr and each.raddr.port in ports)
    return next(found, "")


def _described(info: pylsl.StreamInfo) -> SurveyedStream:
    header = _fields(info.as_xml())
    ports = [_number(header, name) for name in _PORTS]
    return SurveyedStream(
        info.name(),
        info.source_id(),
        info.uid(),
        info.hostname(),
        _FORMATS.get(info.channel_format(), "unknown"),
        [port for port in ports if port],
        data_port=_number(header, _DATA_PORT),
        session=info.session_id(),
    )


def _fields(header: str) -> ET.Element | None:
    """Parse a header; a resolver's one has no description, so it is small."""
    try:
        return read_xml(header, _MAX_HEADER)
    except SpecError:
        return None


def _number(header: ET.Element | None, name: str) -> int:
    text = "0" if header is None else header.findtext(name, "0")
    return int(text) if text.isdecimal() else 0


def _listen(
    info: pylsl.StreamInfo, seen: SurveyedStream, limit_s: float, deadline_s: float
) -> None:
    if time.monotonic() > deadline_s:
        return
    inlet = unopened_inlet(info)
    try:
        _measure_clock(inlet, seen, limit_s)
        inlet.open_stream(limit_s)
        _, stamp = inlet.pull_sample(limit_s)
    except RuntimeError:
        # The time limit is over, or the stream has ended meanwhile.
        return
    if stamp is not None and seen.offset_s is not None:
        seen.stamp_error_s = stamp + seen.offset_s - pylsl.local_clock()


def _measure_clock(inlet: pylsl.StreamInlet, seen: SurveyedStream, limit_s: float) -> None:
    remote_s, uncertainty_s = ctypes.c_double(), ctypes.c_double()
    code = ctypes.c_int()
    measure = lib.lsl_time_correction_ex
    measure.restype = ctypes.c_double
    offset_s: float = measure(
        inlet.obj,
        ctypes.byref(remote_s),
        ctypes.byref(uncertainty_s),
        ctypes.c_double(limit_s),
        ctypes.byref(code),
    )
    if code.value == 0:
        # liblsl's "uncertainty" is the round trip of its best packet.
        seen.offset_s, seen.round_trip_s = offset_s, uncertainty_s.value


if __name__ == "__main__":
    main()
