"""What the agent costs with a virtual device of every kind, which run in another process."""

from __future__ import annotations

import json
import statistics
import tempfile
import time
from collections.abc import Generator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from benchmarks.processes import PORT_RANGE, BenchError, Process, Processes
from biosensor_gateway.demo.virtual_devices import one_of_each
from tests.rigs.lab_client import LabProcess, settings_toml

SENSORS = one_of_each()
_CONNECT_S = 60.0
_SETTLE_S = 5.0


@dataclass(frozen=True, slots=True)
class AgentLoad:
    """One agent, every device, every stream."""

    seconds: float
    cpu_percent: float  # Of one core: the agent's process alone, with bleak's stock Linux backend.
    memory_mb: float  # Resident, at the end.
    # p50_ms, p99_ms: from a packet's arrival at the transport to the end of its push into LSL.
    p50_ms: float
    p99_ms: float
    pushes: int  # How many were measured.
    samples_a_second: float  # Over all streams.


@contextmanager
def streaming_agent(
    port_range: int = PORT_RANGE, sensors: Sequence[str] = SENSORS
) -> Generator[tuple[Process, Processes]]:
    """Run the agent in the block, with every device streaming; see `agent_role`.

    Parameters
    ----------
    port_range
        Of LSL, for its outlets and those of programs beside it: four ports for each.
    sensors
        Of which it has a virtual device each.

    Raises
    ------
    BenchError
        If a device does not stream, or the agent does not end well.
    """
    devices = [{"key": name, "sensor": name, "options": {"kept": 0}} for name in sensors]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        with LabProcess(devices, folder) as lab, Processes(folder, port_range) as processes:
            settings = folder / "settings.toml"
            settings.write_text(settings_toml(lab, {each: each for each in sensors}))
            processes.environment |= lab.environment
            processes.environment["BIOSENSOR_GATEWAY_STATE"] = str(folder)
            agent = processes.start("benchmarks.agent_role", str(settings))
            agent.expect("streaming", _CONNECT_S)
            time.sleep(_SETTLE_S)
            yield agent, processes
            agent.wait()


def measure(seconds: float) -> AgentLoad:
    """Run the agent for so long after every device streams.

    Raises
    ------
    BenchError
        If a device does not stream.
    """
    with streaming_agent() as (agent, _):
        agent.tell()
        agent.expect("measuring")
        cpu_s, begin = agent.cpu_s, time.monotonic()
        time.sleep(seconds)
        cpu_s, elapsed_s = agent.cpu_s - cpu_s, time.monotonic() - begin
        memory_mb = agent.memory_mb
        agent.tell()
        figures = json.loads(agent.line())
    delays = sorted(figures["delays_ms"])
    if len(delays) < 100:
        raise BenchError("the agent pushed next to nothing")
    return AgentLoad(
        seconds=elapsed_s,
        cpu_percent=100 * cpu_s / elapsed_s,
        memory_mb=memory_mb,
        p50_ms=statistics.median(delays),
        p99_ms=delays[int(0.99 * len(delays))],
        pushes=len(delays),
        samples_a_second=figures["samples"] / elapsed_s,
    )
