"""The commands as processes."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest


class Command:
    """Runs the command with a recording and settings of its own."""

    def __init__(self, folder: Path) -> None:
        self.recording = folder / "study.xdf"
        self.usual_settings = folder / "settings.toml"

    def __call__(
        self, *arguments: str, content: bytes | None = None, command: str = "check"
    ) -> tuple[int, str, str]:
        if content is not None:
            self.recording.write_bytes(content)
        done = subprocess.run(
            [sys.executable, "-m", "biosensor_gateway.cli", "xdf", command, *arguments],
            capture_output=True,
            timeout=60,
            text=True,
            check=False,
            encoding="utf-8",
            env={
                **os.environ,
                "BIOSENSOR_GATEWAY_SETTINGS": str(self.usual_settings),
                "PYTHONIOENCODING": "utf-8",
            },
        )
        assert "Traceback" not in done.stderr
        return done.returncode, done.stdout, done.stderr

    def json(self, content: bytes, *arguments: str) -> tuple[int, dict[str, Any]]:
        self.recording.write_bytes(content)
        code, printed, _ = self(str(self.recording), "--json", *arguments)
        return code, json.loads(printed)


@pytest.fixture
def command(tmp_path: Path) -> Command:
    return Command(tmp_path)
