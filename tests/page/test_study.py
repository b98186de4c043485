"""A study of several people: each one's data has each one's name, in every file and at its end."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Generator
from pathlib import Path
from typing import Any

import pytest

from tests.page.conftest import DEADLINE_S, Server
from tests.rigs.zephyr import SteeredBioHarness

pytestmark = pytest.mark.nightly

DEVICE = '[[device]]\nsensor = "zephyr"\nunit = "{}"\nport = "{}"\nlabel = "{}"\n'
RECORDED_S = 8.0
"""Until clock offsets are there."""


class Study:
    """Records by the page's interface, and looks at files by commands."""

    def __init__(self, server: Server, folder: Path) -> None:
        self._server, self._cookie = server, server.enter()
        self._folder = folder

    def tell(self, method: str, path: str, **content: Any) -> tuple[int, dict[str, Any]]:
        answer = self._server.tell(method, path, self._cookie, content)
        return answer.status, json.loads(answer.body)

    def status(self) -> dict[str, Any]:
        return json.loads(self._server.request("GET", "/api/v1/status", self._cookie).body)

    def start(self, participant: str, **more: bool) -> int:
        content = {"participant": participant, "folder": str(self._folder), **more}
        return self.tell("POST", "recording/start", **content)[0]

    def stop(self) -> dict[str, Any]:
        assert self.tell("POST", "recording/stop")[0] == 200
        return self.status()["recording"]["verdict"]

    def command(self, *arguments: str) -> tuple[int, str]:
        done = subprocess.run(
            [sys.executable, "-m", "biosensor_gateway.cli", *arguments],
            env=self._server.programs.environment,
            capture_output=True,
            text=True,
            check=False,
        )
        return done.returncode, done.stdout + done.stderr


@pytest.fixture
def study(server: Server, tmp_path: Path) -> Generator[Study]:
    with SteeredBioHarness() as first, SteeredBioHarness() as second:
        settings = server.programs.settings
        settings.write_text(
            DEVICE.format("A", first.port, "chest") + DEVICE.format("B", second.port, "back")
        )
        running = Study(server, tmp_path / "recordings")
        assert running.tell("POST", "agent/start")[0] == 200

        def stream() -> bool:
            return [each["state"] for each in running.status()["devices"]] == ["streaming"] * 2

        deadline = time.monotonic() + DEADLINE_S
        while not stream():
            assert time.monotonic() < deadline
            time.sleep(0.2)
        yield running


def test_each_has_its_own_name_and_a_wrong_one_is_never_green(study: Study) -> None:
    files: list[str] = []
    for name in ("P01", "P02", "P03"):
        assert study.tell("PUT", "participant", participant=name)[0] == 200
        assert study.start(name) == 200
        time.sleep(RECORDED_S)
        verdict = study.stop()
        assert verdict["colour"] != "red", verdict
        assert not any("called" in each for each in verdict["findings"])
        files.append(verdict["file"])
    # Whatever the settings are by now.
    for file in files:
        code, said = study.command("xdf", "check", file)
        assert code == 0, said

    # In a terminal, too.
    folder = str(Path(files[0]).parent)
    code, said = study.command("record", "start", "--here", "--folder", folder,
                               "--participant", "P09")  # fmt: skip
    assert code == 2
    assert "the file is called P09, but its sensors are worn by P03" in said
    assert study.start("P09") == 409
    assert study.start("P09", other_participants=True) == 200
    time.sleep(RECORDED_S)
    verdict = study.stop()
    assert verdict["colour"] == "red"
    assert verdict["findings"][0] == "the file is called P09, but its sensors are worn by P03"
    assert study.command("xdf", "check", verdict["file"])[0] == 1
    code, said = study.command("xdf", "export", verdict["file"], "--to", "bids")
    assert (code, "--whose" in said) == (1, True)
    dataset = Path(verdict["file"]).with_name("dataset")
    code, said = study.command("xdf", "export", verdict["file"], "--to", "bids", "--whose", "name",
                               "--output", str(dataset))  # fmt: skip
    assert code == 0, said
    assert [each.name for each in dataset.glob("sub-*")] == ["sub-P09"]


def test_what_is_renamed_or_removed_meanwhile_is_asked_about_and_red(study: Study) -> None:
    assert study.start("P01", set_sensors=True) == 200
    time.sleep(RECORDED_S)
    which = {"sensor": "zephyr", "unit": "A"}
    assert study.tell("PATCH", "devices", **which, participant="P02")[0] == 409
    assert study.tell("DELETE", "devices", **which)[0] == 409
    code, said = study.command("reload")
    assert (code, said) == (0, "nothing has changed for any device\n")
    confirmed = {"while_recording": True}
    assert study.tell("PATCH", "devices", **which, participant="P02", **confirmed)[0] == 200
    time.sleep(RECORDED_S)
    removed = {**confirmed, "sensor": "zephyr", "unit": "B"}
    assert study.tell("DELETE", "devices", **removed)[0] == 200
    time.sleep(RECORDED_S)
    verdict = study.stop()
    assert verdict["colour"] == "red"
    first, second, third = verdict["findings"][:3]
    assert first.startswith("zephyr/A of P01 was removed or renamed in the settings at ")
    assert second.startswith("zephyr/B of P01 was removed or renamed in the settings at ")
    assert "the agent also had P02@zephyr.chest, of which" in third
