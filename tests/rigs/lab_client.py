"""Starts and steers virtual devices in another process; see :mod:`tests.rigs.lab`."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from tests.rigs.hosts.lan import Host

STOP_TIMEOUT_S = 20.0


class Samples(NamedTuple):
    times: NDArray[np.float64]
    values: NDArray[np.float64]


class LabProcess:
    """Virtual devices in a process of their own; a context manager.

    Parameters
    ----------
    devices
        Each with ``key``, ``sensor`` and ``options`` (arguments of its class).
    folder
        Where truths are passed on.
    computer
        On which they are; this machine if there is none.
    """

    def __init__(
        self, devices: Sequence[Mapping[str, Any]], folder: Path, computer: Host | None = None
    ) -> None:
        self._folder = folder
        command = [sys.executable, "-m", "tests.rigs.lab", json.dumps(devices)]
        self._process = subprocess.Popen(
            computer.command(*command) if computer else command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            cwd=Path(__file__).parents[2],
        )
        try:
            described = self._read()
        except BaseException:
            self._end()
            raise
        self.environment: dict[str, str] = described["environment"]
        """What a process needs to find the devices."""
        self.settings: dict[str, dict[str, Any]] = described["settings"]
        self.faults: dict[str, list[str]] = described["faults"]

    @property
    def pid(self) -> int:
        return self._process.pid

    def apply(self, key: str, kind: str, value: float) -> None:
        self._command(do="apply", key=key, kind=kind, value=value)

    def clear(self, key: str, kind: str) -> None:
        self._command(do="clear", key=key, kind=kind)

    def call(self, key: str, method: str, **options: object) -> None:
        """Do with a device what only its class can do, as docking."""
        self._command(do="call", key=key, method=method, options=options)

    def truth(self, key: str) -> dict[str, Samples]:
        """What a device has sent so far, by data name."""
        path = self._folder / f"truth-{key}.npz"
        self._command(do="truth", key=key, path=str(path))
        with np.load(path) as arrays:
            names = {name.rpartition(".")[0] for name in arrays.files}
            return {
                name: Samples(arrays[f"{name}.times"], arrays[f"{name}.values"]) for name in names
            }

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._end()

    def _end(self) -> None:
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.close()
        try:
            self._process.wait(STOP_TIMEOUT_S)
        finally:
            self._process.kill()
            self._process.wait()
            self._process.stdout.close()

    def _command(self, **command: object) -> None:
        assert self._process.stdin is not None
        self._process.stdin.write(json.dumps(command) + "\n")
        self._process.stdin.flush()
        answer = self._read()
        if "error" in answer:
            raise RuntimeError(answer["error"])

    def _read(self) -> dict[str, Any]:
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        if not line:
            raise RuntimeError("the lab's process ended; see its standard error")
        return json.loads(line)


def settings_toml(
    lab: LabProcess, sensors: Mapping[str, str], extra: Mapping[str, str] | None = None
) -> str:
    """The settings file that leads an agent to devices of a lab.

    Parameters
    ----------
    sensors
        Sensor by key.
    extra
        Further lines of TOML by key.
    """
    blocks: list[str] = []
    for key, sensor in sensors.items():
        fields = {"sensor": sensor, "unit": key.upper(), **lab.settings[key]}
        lines = [f"{name} = {json.dumps(value)}" for name, value in fields.items()]
        blocks.append("\n".join(["[[device]]", *lines, (extra or {}).get(key, "")]))
    return "\n\n".join(blocks) + "\n"
