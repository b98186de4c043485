"""A lab of many computers: four with an agent each, two robots, a recorder's desk; at two sites.

Each agent has virtual devices of its own, in a process beside it that survives it and knows
what was measured. Either all computers are on one network, or the last agent and the second
robot are at another site, behind a `link.Link`.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
import uuid
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from biosensor_common.errors import ConfigError
from biosensor_gateway.agent import status_file
from tests.rigs.hosts.lan import Host, Lan
from tests.rigs.hosts.link import Delays, Link
from tests.rigs.hosts.programs import Program
from tests.rigs.lab_client import LabProcess, Samples, settings_toml

PCS = ("pc-1", "pc-2", "pc-3", "pc-4")
ROBOTS = ("robot-1", "robot-2")
DESK = "desk"
# Nobody boots two computers at the same time. Whole seconds, so that a measured difference of
# two clocks has its error behind the point.
CLOCK_OFFSETS_S = {
    "pc-1": 86_400,
    "pc-2": 3_600,
    "pc-3": 7_200,
    "robot-1": 0,
    DESK: 500,
    "pc-4": 1_000_000,
    "robot-2": 50_000,
}
_AWAY = ("pc-4", "robot-2")
_NETWORKS = ("10.77.0", "10.78.0")
_SERVER_PORT = 11_811
DEADLINE_S = 120.0


class Setting(NamedTuple):
    """How the computers of a lab are joined."""

    name: str
    delays: Delays | None  # Of the link between the sites; None where all are on one network.
    # Whether the network of the second robot carries no multicast, so that it has its streams by
    # `known_peers` and is heard by way of a Fast DDS discovery server.
    is_deaf: bool


class Sites:
    """The computers, and the agents with their devices; a context manager.

    Parameters
    ----------
    sensors
        Kinds of the virtual devices, by computer; a person wears those of a computer.
    kept_alive
        The computers whose agent is started again when it dies.
    """

    def __init__(
        self,
        setting: Setting,
        sensors: Mapping[str, Sequence[str]],
        kept_alive: Sequence[str],
        folder: Path,
    ) -> None:
        self._setting, self._sensors, self._folder = setting, sensors, folder
        self._kept_alive = kept_alive
        self._session = f"sites-{uuid.uuid4().hex}"
        self._stack = ExitStack()
        self._labs: dict[str, LabProcess] = {}
        self._agents: dict[str, Program] = {}

    def __enter__(self) -> Self:
        with ExitStack() as stack:
            self._lans = self._join(stack)
            # A process dies with the thread that has started it, so these stay until the end.
            threads = stack.enter_context(ThreadPoolExecutor(len(PCS)))
            for pc, lab in zip(PCS, threads.map(self._lab, PCS), strict=True):
                self._labs[pc] = stack.enter_context(lab)
            for pc in PCS:
                self._agents[pc] = stack.enter_context(self._agent(pc))
            self._stack = stack.pop_all()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._stack.__exit__(kind, error, trace)

    def __getitem__(self, name: str) -> Host:
        return self._lan(name)[name]

    def unplug(self, name: str) -> None:
        """Pull a computer's cable out of its switch."""
        self._lan(name).unplug(name)

    def plug_in(self, name: str) -> None:
        """Put the cable back."""
        self._lan(name).plug_in(name)

    def await_streaming(self) -> None:
        """Wait until every device of every agent streams.

        Raises
        ------
        TimeoutError
            With what the agents that are late have said.
        """
        end = time.monotonic() + DEADLINE_S
        while late := [pc for pc in PCS if not self._is_streaming(pc)]:
            if time.monotonic() > end:
                words = "\n".join(self._agents[pc].last_words for pc in late)
                raise TimeoutError(f"{late} do not stream\n{words}")
            time.sleep(0.2)

    def serving(self, pc: str) -> int:
        """Process that is the agent."""
        return int(status_file.read_status(self._state(pc))["process"])

    def truth(self, pc: str, sensor: str) -> dict[str, Samples]:
        """What a device has sent so far, by data name, at times of its computer's clock."""
        return self._labs[pc].truth(sensor)

    def peers(self, name: str) -> list[str]:
        """Addresses of the agents' computers that multicast does not bring to a computer."""
        near = [] if self._is_deaf(name) else [pc for pc in PCS if self._lan(pc) is self._lan(name)]
        return [self._lan(pc).address(pc) for pc in PCS if pc not in near]

    def environment(self, name: str) -> dict[str, str]:
        """Environment of a program on a computer, with an LSL configuration of its own."""
        config = self._place(name) / "lsl_api.cfg"
        if not config.exists():
            config.write_text(f"[lab]\nSessionID = {self._session}\n")
        scope = {"LSLAPICFG": str(config), "ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET"}
        return {**os.environ, **scope, "BIOSENSOR_GATEWAY_STATE": str(self._state(name))}

    def recorder_environment(self, name: str) -> dict[str, str]:
        """Environment of LabRecorder, with the configuration that the agent's program writes.

        It names the computers of all agents: of 126 streams on its own network LabRecorder found
        50 or 60 by multicast in the second for which it looks, and all of those that it asks for.
        """
        environment, path = self.environment(name), self._place(name) / "recorder.cfg"
        peers = [word for pc in PCS for word in ("--peer", self._lan(pc).address(pc))]
        command = ("-m", "biosensor_gateway.cli", "config", "lsl", "--for", "two-pc", *peers)
        subprocess.run(
            [sys.executable, *command, "--out", path],
            env=environment,
            check=True,
            capture_output=True,
        )
        return {**environment, "LSLAPICFG": str(path)}

    def discovery_server(self) -> tuple[list[str], dict[str, str]]:
        """Command of a Fast DDS discovery server on the second robot, and its clients' setting."""
        address = self._lan(ROBOTS[1]).address(ROBOTS[1])
        program = Path(sys.executable).with_name("fast-discovery-server")
        options = ("-i", "0", "-l", address, "-p", str(_SERVER_PORT))
        return [str(program), *options], {"ROS_DISCOVERY_SERVER": f"{address}:{_SERVER_PORT}"}

    def _join(self, stack: ExitStack) -> list[Lan]:
        delays = self._setting.delays
        away = _AWAY if delays else ()
        sides = [
            {name: s for name, s in CLOCK_OFFSETS_S.items() if (name in away) is is_away}
            for is_away in (False, True)
        ]
        lans = [
            stack.enter_context(Lan(side, network))
            for side, network in zip(sides, _NETWORKS, strict=True)
            if side
        ]
        if delays:
            stack.enter_context(Link(lans[0], lans[1], delays, self._folder))
        if self._setting.is_deaf:
            lans[-1].drop_multicast()
        return lans

    def _lan(self, name: str) -> Lan:
        return next(lan for lan in self._lans if name in lan)

    def _is_deaf(self, name: str) -> bool:
        return self._setting.is_deaf and self._lan(name) is self._lans[-1]

    def _place(self, name: str) -> Path:
        place = self._folder / name
        place.mkdir(exist_ok=True)
        return place

    def _state(self, name: str) -> Path:
        return self._place(name) / "state"

    def _lab(self, pc: str) -> LabProcess:
        devices = [
            {"key": sensor, "sensor": sensor, "options": {"seed": 10 * PCS.index(pc) + number}}
            for number, sensor in enumerate(self._sensors[pc])
        ]
        return LabProcess(devices, self._place(pc), self[pc])

    def _agent(self, pc: str) -> Program:
        lab, place = self._labs[pc], self._place(pc)
        worn_by = f'participant = "{participant(pc)}"'
        sensors = {sensor: sensor for sensor in self._sensors[pc]}
        settings = place / "settings.toml"
        settings.write_text(settings_toml(lab, sensors, dict.fromkeys(sensors, worn_by)))
        keep_alive = ["--keep-alive"] if pc in self._kept_alive else []
        environment = {**self.environment(pc), **lab.environment}
        module, run = "biosensor_gateway.cli", ("run", "--settings", str(settings), *keep_alive)
        return Program(self[pc], environment, place, module, *run)

    def _is_streaming(self, pc: str) -> bool:
        try:
            devices = status_file.read_status(self._state(pc))["devices"]
        except ConfigError:
            return False
        return all(each["state"] == "streaming" for each in devices)


def participant(pc: str) -> str:
    """Who wears the devices of a computer."""
    return f"p{PCS.index(pc) + 1:02}"


def unix_s(name: str, times: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return times of a computer's monotonic clock, in seconds, as Unix times."""
    return times - CLOCK_OFFSETS_S[name] + (time.time() - time.monotonic())
