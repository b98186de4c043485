"""Bad devices beside a good one: each is named with its fault, and the good one streams on."""

from __future__ import annotations

import contextlib
import os
import random
import subprocess
import threading
from collections.abc import Callable, Generator
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any, NamedTuple

import pytest
import serial

from biosensor_common.errors import ConfigError
from biosensor_gateway.agent import status_file
from tests.rigs.zephyr import SteeredBioHarness

pytestmark = pytest.mark.nightly

# What a serial line of 115200 baud carries in a twentieth of a second.
GARBAGE_BYTES, GARBAGE_EVERY_S = 576, 0.05

Until = Callable[[Callable[[], bool]], None]
StartCli = Callable[..., AbstractContextManager["subprocess.Popen[bytes]"]]


class Lab(NamedTuple):
    """A running agent with one good device and four bad ones."""

    folder: Path
    process: subprocess.Popen[bytes]
    ports: dict[str, str]

    def device(self, unit: str) -> dict[str, Any]:
        with contextlib.suppress(ConfigError):
            for device in status_file.read_status(self.folder)["devices"]:
                if device["unit"] == unit:
                    return device
        return {}

    def lines_with(self, text: str) -> list[str]:
        """Lines of the log."""
        log = (self.folder / "stderr.txt").read_text()
        return [line for line in log.splitlines() if text in line]

    def pushed(self) -> int:
        streams = self.device("good").get("streams", {})
        return streams.get("zephyr-good-ecg", {}).get("pushed", 0)


@pytest.fixture(scope="module")
def ports(tmp_path_factory: pytest.TempPathFactory) -> Generator[dict[str, str]]:
    masters: list[int] = []

    def terminal() -> str:
        master, slave = os.openpty()
        masters.extend((master, slave))
        return os.ttyname(slave)

    mute, held, noisy = terminal(), terminal(), terminal()
    over = threading.Event()
    babble = threading.Thread(target=babbling, args=(masters[4], over))
    babble.start()
    with serial.Serial(held, exclusive=True), SteeredBioHarness() as good:
        yield {
            "good": good.port,
            "absent": str(tmp_path_factory.mktemp("ports") / "ttyUSB9"),
            "held": held,
            "noisy": noisy,
            "mute": mute,
        }
    over.set()
    babble.join()
    for handle in masters:
        os.close(handle)


def babbling(master: int, over: threading.Event) -> None:
    """Write random bytes to whoever listens."""
    os.set_blocking(master, False)
    noise = random.Random(1)
    while not over.wait(GARBAGE_EVERY_S):
        with contextlib.suppress(BlockingIOError):
            os.write(master, noise.randbytes(GARBAGE_BYTES))


@pytest.fixture(scope="module")
def lab(
    ports: dict[str, str], cli_process: StartCli, tmp_path_factory: pytest.TempPathFactory
) -> Generator[Lab]:
    folder = tmp_path_factory.mktemp("lab")
    path = folder / "settings.toml"
    path.write_text(
        "".join(
            f'[[device]]\nsensor = "zephyr"\nunit = "{unit}"\nport = "{port}"\n'
            for unit, port in ports.items()
        )
    )
    with cli_process(folder, "run", "--settings", str(path)) as process:
        yield Lab(folder, process, ports)
        process.terminate()
        assert process.wait(15.0) == 0
    assert "Traceback" not in (folder / "stderr.txt").read_text()


@pytest.mark.parametrize(
    ("unit", "reason", "words"),
    [
        ("absent", "absent", "there is no such port"),
        ("held", "busy", "another program holds the port"),
        ("noisy", "garbage", "what answers is not a BioHarness"),
        ("mute", "no_reply", "the device does not answer"),
    ],
)
def test_a_bad_device_is_named_with_its_fault_and_disturbs_no_other(
    lab: Lab, until: Until, unit: str, reason: str, words: str
) -> None:
    until(lambda: words in (lab.device(unit).get("error") or ""))
    error: str = lab.device(unit)["error"]
    assert error.startswith(f"{lab.ports[unit]}: ")
    # The log is written by a thread of its own.
    until(lambda: bool(lab.lines_with(error)))
    (line,) = lab.lines_with(error)
    assert "warning" in line
    assert f"unit={unit!r}" in line
    assert f"reason={reason!r}" in line
    until(lambda: lab.pushed() > 0)
    pushed = lab.pushed()
    until(lambda: lab.pushed() > pushed)
    good = lab.device("good")
    assert (good["state"], good["connections"], good["error"]) == ("streaming", 1, None)
    assert all(counters["lost"] == 0 for counters in good["streams"].values())


def test_a_device_that_was_put_right_streams_without_anybody_s_help(lab: Lab, until: Until) -> None:
    with SteeredBioHarness() as repaired:
        Path(lab.ports["absent"]).symlink_to(repaired.port)
        until(lambda: lab.device("absent").get("state") == "streaming")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[lsl\n", ["line 1", "not valid TOML"]),
        ('[lsl]\nsesion_id = "a"\n', ["line 2", "lsl.sesion_id", "unknown"]),
        ('[lsl]\nport_range = "many"\n', ["line 2", "lsl.port_range", "whole number"]),
        (
            '[[device]]\nsensor = "zephyr"\nunit = 7\nport = "COM7"\n',
            ["line 3", "device.unit", "text in quotes"],
        ),
    ],
)
def test_bad_settings_are_a_usage_error_that_says_what_and_where(
    cli_process: StartCli, tmp_path: Path, text: str, words: list[str]
) -> None:
    path = tmp_path / "settings.toml"
    path.write_text(text)
    with cli_process(tmp_path, "run", "--settings", str(path)) as process:
        assert process.wait(30.0) == 2
    told = (tmp_path / "stderr.txt").read_text()
    assert told.count("\n") == 1
    assert told.startswith(f"biosensor-gateway: {path}")
    assert [word for word in words if word not in told] == []
