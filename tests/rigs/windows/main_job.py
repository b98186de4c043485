"""One run of the main job on a virtual PC, and whether all that was sent was recorded."""

from __future__ import annotations

import json
import subprocess
import time
from collections.abc import Callable, Collection, Mapping
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple, Self, cast

import numpy as np
import pyxdf
from numpy.typing import NDArray

from biosensor_common import naming
from biosensor_common.quantities import ContentType
from biosensor_common.spec import DeviceIdentity
from biosensor_gateway.system.logs import LOG_FILE_NAME
from installer.wine.prefix import windows_path
from tests.faults.matching import UnknownSampleError, match
from tests.faults.recorder import Recorded
from tests.rigs.hosts.completeness import MARGIN_S, Span, canonical
from tests.rigs.hosts.lan import Host, Lan
from tests.rigs.hosts.pair import VIRTUAL_UNIT, Observation, Pair, Place, Places
from tests.rigs.hosts.programs import SteeredProgram
from tests.rigs.lab_client import Samples
from tests.rigs.processes import before_others
from tests.rigs.windows.clocks import Clocks
from tests.rigs.windows.pc import WindowsPc
from tests.rigs.windows.program import RunningProgram

# One run of the main job on a virtual PC: devices, the installed program, LabRecorder.

# One run of the main job: devices, the installed program, ROS topics and an XDF file.

SENSORS = ("empatica_e4", "emotiv_insight", "shimmer3_gsr", "zephyr")
# Wine has no Bluetooth.
UNREACHABLE = "polar_h10"
PC = "pc"
SECONDS = 60.0
# The first chunk holds samples of the four seconds before it.
LEAD_S = MARGIN_S + 4.0
# A wristband's heart rate comes six seconds after the beat.
LATEST_S = 7.0
# A busy machine has a backlog.
BACKLOG_LIMIT_S = 120.0
DEADLINE_S = 30.0
_COM_PORTS = {"shimmer3_gsr": 5, "zephyr": 6}


class MainJob(NamedTuple):
    """What was sent, and what came of it.

    Attributes
    ----------
    minute
        In which all that was measured must have come.
    truth
        What the devices have sent, by source_id; times are Unix time, in seconds.
    recorded
        The XDF file, by source_id.
    status, log
        What ``status`` said within the minute, as text and as JSON, and the log of the run.
    devices_clocks, recorder_clocks
        Those of the computers of the devices and of LabRecorder.
    """

    expected: dict[str, Place]
    minute: Span
    truth: dict[str, Samples]
    recorded: dict[str, XdfStream]
    observation: Observation
    status: str
    devices: dict[str, dict[str, Any]]
    log: list[dict[str, Any]]
    devices_clocks: Clocks
    recorder_clocks: Clocks


def run(
    pc: WindowsPc,
    lan: Lan,
    lsl_config: Path,
    environment: Mapping[str, str],
    other_host: str,
    folder: Path,
    steady: Collection[str],
) -> MainJob:
    """Let the installed program stream all devices for a minute, and watch what comes of it.

    Parameters
    ----------
    pc
        With the program; it is the computer `PC` of the network.
    lsl_config, environment
        LSL's configuration of all programs, and the environment of those on Linux.
    other_host
        Where node, subscriber and LabRecorder run; may be `PC`.
    folder
        For recordings and logs.
    steady
        By source_id the streams that never pause; they tell when all of the minute has come.
    """
    places = Places(agent=PC, node=other_host, subscriber=other_host, receiver=PC)
    with ExitStack() as stack:
        devices = stack.enter_context(
            SteeredProgram(lan[PC], environment, folder, _rig("devices"), *SENSORS)
        )
        described = devices.ask("describe")
        _configure(pc, described["settings"])
        windows = {**described["environment"], "LSLAPICFG": windows_path(lsl_config)}
        agent = InstalledAgent(pc, lan[PC], windows)
        pair = stack.enter_context(
            Pair(lan, places, environment, folder, agent=agent, sensors=SENSORS)
        )
        recorder = stack.enter_context(
            SteeredProgram(lan[other_host], environment, folder, _rig("recorder"))
        )
        pair.await_matched()
        sources = list(pair.expected)
        file = recorder.ask("start", folder=str(folder), source_ids=sources)
        begin = time.time() + LEAD_S
        minute = Span(begin, begin + SECONDS)
        _sleep_until(begin + SECONDS / 2)
        status, figures = _answer(agent, "status"), _answer(agent, "status", "--json")
        _await_all(pair, devices, steady, minute.end + LATEST_S)
        time.sleep(MARGIN_S)
        observation = pair.observe()
        clocks = [Clocks(**each.ask("clocks")) for each in (devices, recorder)]
        recorder.ask("stop")
        truth = _truth(devices, clocks[0], folder)
    lines = [json.loads(line) for line in _log(pc).read_text(encoding="utf-8").splitlines()]
    return MainJob(
        pair.expected,
        minute,
        truth,
        read(Path(file)),
        observation,
        status,
        {device["sensor"]: device for device in json.loads(figures)["devices"]},
        lines,
        *clocks,
    )


def _rig(name: str) -> str:
    return f"tests.rigs.windows.{name}"


def _answer(agent: InstalledAgent, *arguments: str) -> str:
    """Ask until it is answered: on a busy machine the agent's report may be too old."""
    deadline = time.monotonic() + DEADLINE_S
    while (ended := agent.gateway(*arguments)).returncode:
        if time.monotonic() > deadline:
            raise TimeoutError(f"{' '.join(arguments)}: {ended.stdout}\n{agent.last_words}")
    return ended.stdout


def _await_all(pair: Pair, devices: SteeredProgram, steady: Collection[str], time_s: float) -> None:
    """Wait until streams have come up to a Unix time, and what was sent before them, too."""
    _sleep_until(time_s)
    deadline = time.monotonic() + BACKLOG_LIMIT_S
    while behind := _behind(pair, devices, steady, time_s):
        if time.monotonic() > deadline:
            raise TimeoutError(f"still behind, in seconds: {behind}")
        time.sleep(1.0)


def _behind(
    pair: Pair, devices: SteeredProgram, steady: Collection[str], time_s: float
) -> dict[str, float]:
    """Seconds that streams and their topics still lack of a Unix time, by source_id and name."""
    clocks = Clocks(**devices.ask("clocks"))
    unix_minus_stamp_s = clocks.unix_minus_lsl - clocks.windows_minus_lsl
    observation = pair.observe()
    streams = observation.streams
    newest = {s: float(streams[s].stamps[-1]) + unix_minus_stamp_s for s in steady}
    # Those of standard messages have a stamp, and what the node is behind with others shows there.
    stems = tuple(f"{pair.expected[source].topic}_" for source in steady)
    newest |= {
        name: float(topic.stamps[-1]) / 1e9
        for name, topic in observation.topics.items()
        if name.startswith(stems) and topic.stamps.any()
    }
    return {s: round(time_s - came_s, 1) for s, came_s in newest.items() if came_s < time_s}


def _sleep_until(time_s: float) -> None:
    time.sleep(max(0.0, time_s - time.time()))


def _log(pc: WindowsPc) -> Path:
    return pc.user_folder / LOG_FILE_NAME


def _configure(pc: WindowsPc, settings: Mapping[str, Mapping[str, Any]]) -> None:
    """Plug the serial devices in, and write the settings where the PC's user has them."""
    blocks = [_block(UNREACHABLE, {})]
    for sensor, described in settings.items():
        fields = dict(described)
        if sensor in _COM_PORTS:
            pc.plug_in(_COM_PORTS[sensor], fields["port"])
            fields["port"] = f"COM{_COM_PORTS[sensor]}"
        if "ca_file" in fields:
            fields["ca_file"] = windows_path(Path(fields["ca_file"]))
        blocks.append(_block(sensor, fields))
    pc.user_folder.mkdir(parents=True, exist_ok=True)
    (pc.user_folder / "settings.toml").write_text("\n".join(blocks), encoding="utf-8")
    # Of a run before this one.
    _log(pc).unlink(missing_ok=True)


def _block(sensor: str, fields: Mapping[str, Any]) -> str:
    # A string of JSON, a backslash and all, is one of TOML.
    values = {"sensor": sensor, "unit": VIRTUAL_UNIT, **fields}
    lines = [f"{name} = {json.dumps(value)}" for name, value in values.items()]
    return "\n".join(["[[device]]", *lines, ""])


def _truth(devices: SteeredProgram, clocks: Clocks, folder: Path) -> dict[str, Samples]:
    truth: dict[str, Samples] = {}
    for sensor in SENSORS:
        path = folder / f"truth-{sensor}.npz"
        devices.ask("truth", key=sensor, path=str(path))
        identity = DeviceIdentity(sensor, VIRTUAL_UNIT)
        with np.load(path) as arrays:
            for name in {key.partition(".")[0] for key in arrays.files}:
                truth[naming.source_id(identity, name)] = Samples(
                    arrays[f"{name}.times"] + clocks.unix_minus_lsl, arrays[f"{name}.values"]
                )
    return truth


# The installed program streaming on a Windows PC that is a computer of the network.
_TAIL = 4000
# Empty is unset for Windows: the program uses its user's own folders.
_OWN_PLACES = {"BIOSENSOR_GATEWAY_SETTINGS": "", "BIOSENSOR_GATEWAY_STATE": ""}


class InstalledAgent:
    """``biosensor-gateway run`` of a PC; a context manager.

    Leaving it ends the program by its own ``stop``, and then all that runs on the PC.

    Parameters
    ----------
    pc
        Has the program and its settings; what runs on it already is ended.
    host
        The computer of the network that it is; Wine's server starts there with the first
        program, and the sockets of all of them are the server's.
    environment
        More variables for all its programs, as Windows is to see them.

    Raises
    ------
    AssertionError
        On leaving, if it does not end with exit code 0.
    """

    def __init__(self, pc: WindowsPc, host: Host, environment: Mapping[str, str]) -> None:
        self._pc = pc
        self._prefix = replace(
            pc.prefix, environment={**environment, **_OWN_PLACES}, before=tuple(host.command())
        )

    def __enter__(self) -> Self:
        self._prefix.end()
        self._program = RunningProgram(self._prefix, self._pc.program, self._pc.user_folder)
        # It starts Wine's server, which so has the same priority.
        before_others(self._program.pid)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        with self._program:
            stopped = self.gateway("stop")
            code = self._program.exit_code()
            # The services of this Windows have the program's outputs, too.
            self._prefix.end()
        if error is None:
            assert (stopped.returncode, code) == (0, 0), f"{stopped.stdout}\n{self.last_words}"

    def gateway(self, *arguments: str) -> subprocess.CompletedProcess[str]:
        """Run another command of the installed program to its end."""
        return self._prefix.attempt(self._pc.program, *arguments)

    @property
    def last_words(self) -> str:
        """The end of what it wrote."""
        return self._program.said()[-_TAIL:]


# What LabRecorder has recorded of the agent's streams, sample by sample.
_load_xdf: Callable[..., tuple[list[dict[str, Any]], dict[str, Any]]] = cast("Any", pyxdf).load_xdf


class XdfStream(NamedTuple):
    """One stream.

    Attributes
    ----------
    stamps : ndarray of float64, shape (n,)
        On the sender's LSL clock, as they were sent.
    times : ndarray of float64, shape (n,)
        The same on the LSL clock of LabRecorder's computer, by its measurements.
    rows : ndarray, shape (n, channels)
        Values, as float32 or text.
    corrections : ndarray of float64
        What LabRecorder measured that its LSL clock is ahead of the sender's, in seconds.
    """

    stamps: NDArray[np.float64]
    times: NDArray[np.float64]
    rows: NDArray[Any]
    corrections: NDArray[np.float64]


def read(path: Path) -> dict[str, XdfStream]:
    """Return all streams by source_id."""
    sent, _ = _load_xdf(str(path), synchronize_clocks=False, dejitter_timestamps=False)
    corrected, _ = _load_xdf(str(path), synchronize_clocks=True, dejitter_timestamps=False)
    times = {_source_id(stream): stream["time_stamps"] for stream in corrected}
    return {
        source: XdfStream(
            np.asarray(stream["time_stamps"], np.float64),
            np.asarray(times[source], np.float64),
            _rows(stream),
            np.asarray(stream["clock_values"], np.float64),
        )
        for stream in sent
        for source in (_source_id(stream),)
    }


def _source_id(stream: Mapping[str, Any]) -> str:
    return stream["info"]["source_id"][0]


def _rows(stream: Mapping[str, Any]) -> NDArray[Any]:
    info, samples = stream["info"], stream["time_series"]
    if info["type"] == [ContentType.COUNTERS]:
        samples = [[canonical(json.loads(sample[0]))] for sample in samples]
    kind = np.str_ if info["channel_format"] == ["string"] else np.float32
    return np.array(samples, kind).reshape(len(samples), int(info["channel_count"][0]))


# Whether all that a device has sent was recorded: every sample once, in order, on time.
Floats = NDArray[np.float64]


class Arrivals(NamedTuple):
    """What was recorded of one stream.

    Attributes
    ----------
    times : ndarray of float64, shape (n,)
        The stamps as Unix time, in seconds.
    values : ndarray of float64, shape (n, channels)
    """

    times: Floats
    values: Floats


def fault(sent: Samples, arrivals: Arrivals, required: Span) -> str:
    """Say what is wrong with what was recorded; an empty text if nothing is.

    Parameters
    ----------
    sent
        What the device has sent, with the Unix times of measuring.
    required
        What was measured in this time must have been recorded.
    """
    wanted = np.flatnonzero(required.holds(sent.times))
    try:
        places = _places(sent, arrivals)
    except UnknownSampleError as error:
        return str(error)
    came = places[np.isin(places, wanted)]
    if len(came) != len(wanted):
        return f"{len(wanted) - len(came)} of {len(wanted)} samples are missing"
    # Where values repeat themselves, one that is missing shows by the times of the others.
    spacing = np.diff(sent.times[places])
    steps = np.abs(np.diff(arrivals.times) - spacing)
    inside = required.holds(sent.times[places[1:]])
    if (steps[inside] > spacing[inside] / 2).any():
        return "the times fit only if a sample is missing or came twice"
    return ""


def stamp_errors(sent: Samples, arrivals: Arrivals, required: Span) -> Floats:
    """Seconds by which each sample of a time is stamped later than it was measured.

    Raises
    ------
    UnknownSampleError
        If a sample was never sent.
    """
    measured = sent.times[_places(sent, arrivals)]
    return (arrivals.times - measured)[required.holds(measured)]


def header_errors(sent: Samples, stamps: Floats, required: Span) -> Floats:
    """Return the same for a topic with nothing but stamps; it is known to be complete."""
    inside = stamps[required.holds(stamps)]
    if not len(inside):
        return inside
    start = int(np.abs(sent.times - inside[0]).argmin())
    return inside - sent.times[start : start + len(inside)]


def _places(sent: Samples, arrivals: Arrivals) -> NDArray[np.int64]:
    return match(Recorded(arrivals.times, arrivals.values, arrivals.times), sent)
