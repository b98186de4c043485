# pyright: reportPrivateUsage=false
"""Runs all resolvers of the product in one LSL session, or the streams of another one.

``python -m tests.contracts.two_sessions streams``: outlets until stdin ends.
``python -m tests.contracts.two_sessions resolvers SESSION``: the same outlets, and each resolver;
prints for each the sessions of which it found streams. SESSION is its own.
"""

from __future__ import annotations

import io
import json
import sys
import threading
import time
from collections import defaultdict
from collections.abc import Callable
from contextlib import suppress

import pylsl

from biosensor_common.doctor import lsl_process
from biosensor_common.lsl.network import Network
from biosensor_common.lsl.predicates import EVERYTHING, IN_ANY_SESSION, begins_with
from biosensor_gateway.features.live import Live
from biosensor_gateway.features.outputs import READ_TYPES, feature_streams
from biosensor_gateway.features.sources import Source
from biosensor_gateway.page.network.network_thread import Reader
from biosensor_gateway.recording.recorder import presence, receiver, request
from biosensor_gateway.recording.recorder.programs import predicate
from biosensor_gateway.recording.replay.playback import refuse_if_present
from biosensor_gateway.recording.replay.source import ReplayError
from lsl_to_ros.lsl.discovery import Discovery

WITHOUT_BRACKETS = "without brackets"
ON_PURPOSE = "all sessions on purpose"
LIMIT_S, LONGER_S, STEP_S = 60.0, 2.0, 0.1
ENDINGS = ("ecg", "hr_live", "ecg_sqi")
KINDS = (*READ_TYPES, "GatewayCounters", "HR")

_found: dict[str, set[str]] = defaultdict(set)
_done = threading.Event()


class _Watched(pylsl.ContinuousResolver):
    """Belongs to the thread, that is the case, that made it."""

    def __init__(self, *arguments: object, **options: object) -> None:
        super().__init__(*arguments, **options)  # type: ignore[arg-type]
        is_for_all = options.get("pred") == IN_ANY_SESSION
        self._case = threading.current_thread().name if not is_for_all else ON_PURPOSE

    def results(self) -> list[pylsl.StreamInfo]:
        infos = super().results()
        _found[self._case].update(info.session_id() for info in infos)
        return infos


_resolve = pylsl.resolve_bypred


def _watched_resolve(wanted: str, minimum: int = 1, timeout: float = 1.0) -> list[pylsl.StreamInfo]:
    # One answer is enough for the product; here all are waited for.
    infos = _resolve(wanted, 64, min(timeout, 1.0))
    _found[threading.current_thread().name].update(info.session_id() for info in infos)
    return infos


def _ignore(_request: object) -> None: ...


class _Silent:
    def found(self, source: Source) -> None: ...

    def refused(self, sentence: str) -> None: ...


def _outlets() -> list[pylsl.StreamOutlet]:
    return [
        pylsl.StreamOutlet(
            pylsl.StreamInfo(f"{kind}-{end}", kind, 1, 0.0, "float32", f"{kind}-{end}")
        )
        for kind in KINDS
        for end in ENDINGS
    ]


def _read(query: object) -> None:
    reader = Reader(lambda _samples: None, query)  # type: ignore[arg-type]
    _done.wait()
    reader.stop()


def _discover(query: str) -> None:
    discovery = Discovery(lambda _sentence: None, query)
    while not _done.wait(STEP_S):
        discovery.update()
    discovery.stop()


def _watch(predicate: str) -> None:
    network = Network(predicate)
    while not _done.wait(STEP_S):
        network.streams()


def _unbracketed() -> None:
    resolver = _Watched(pred="type='none' or type='PPG'")
    while not _done.wait(STEP_S):
        resolver.results()


def _recorder_of_ours() -> None:
    ids = [f"{kind}-ecg" for kind in KINDS]
    pylsl.resolve_bypred(predicate([request.VisibleStream(each, each, "") for each in ids]))


def _own_recorder() -> None:
    receiver._say = _ignore
    receiver._Recorder(io.BytesIO(), EVERYTHING).run(_done)


def _replay() -> None:
    # It ends at the first stream of ours, which may come before those of others.
    with suppress(ReplayError):
        refuse_if_present(["none"], [], "a file", allowed_by="", may_be_beside=True)


def _probe() -> None:
    lsl_process._find("PPG-ecg", 1.0)


def _again(look: Callable[[], object]) -> Callable[[], None]:
    def run() -> None:
        while not _done.is_set():
            look()

    return run


CASES: dict[str, Callable[[], None]] = {
    WITHOUT_BRACKETS: _unbracketed,
    "features": lambda: Live(_Silent()).run(_done),
    "features on the page": lambda: _read(feature_streams()),
    "the page of the network": lambda: _read(None),
    "the node": lambda: _discover(""),
    "the node, of two types": lambda: _discover("type='none' or type='PPG'"),
    "the node, of ros_to_lsl": lambda: _discover("desc/ros or true()"),
    "ros_to_lsl, outlets elsewhere": lambda: _watch(begins_with("source_id", "PPG")),
    "before a recording": _again(lambda: presence._search(frozenset())),
    "the recorder, all streams": _again(lambda: pylsl.resolve_bypred(EVERYTHING)),
    "the recorder, only ours": _again(_recorder_of_ours),
    "our own recorder": _own_recorder,
    "before a replay": _again(_replay),
    "doctor, the survey": _again(lambda: lsl_process.survey(1.0, 0.1, 0.0)),
    "doctor, the list": _again(lambda: lsl_process.list_streams(1.0)),
    "doctor, the meeting": _again(lambda: lsl_process.meet("PPG-ecg", 1.0, 0.1)),
    "doctor, the probe": _again(_probe),
}


def _run_resolvers() -> None:
    _kept = _outlets()
    own = sys.argv[2]
    pylsl.ContinuousResolver = _Watched
    pylsl.resolve_bypred = _watched_resolve
    lsl_process.answer = _ignore
    threads = [threading.Thread(target=run, name=case, daemon=True) for case, run in CASES.items()]
    for thread in threads:
        thread.start()
    end = time.monotonic() + LIMIT_S
    while time.monotonic() < end and not (
        all(own in _found[case] for case in CASES) and len(_found[WITHOUT_BRACKETS]) > 1
    ):
        time.sleep(STEP_S)
    time.sleep(LONGER_S)
    _done.set()
    print(json.dumps({case: sorted(_found[case]) for case in CASES}), flush=True)


def _run_streams() -> None:
    outlets = _outlets()
    print(len(outlets), flush=True)
    sys.stdin.read()


if __name__ == "__main__":
    {"streams": _run_streams, "resolvers": _run_resolvers}[sys.argv[1]]()
