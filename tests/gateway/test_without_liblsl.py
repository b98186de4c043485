"""A computer for which pylsl brings no library: ARM Linux, or an older glibc."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]

pytestmark = pytest.mark.seam


def test_every_help_is_shown_and_every_use_says_one_sentence(tmp_path: Path) -> None:
    ended = subprocess.run(
        [sys.executable, "-m", "tests.gateway.without_liblsl"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )
    assert ended.returncode == 0, ended.stderr
    said: dict[str, dict[str, list[Any]]] = json.loads(ended.stdout)
    assert len(said["helps"]) > 40
    assert {command: each for command, each in said["helps"].items() if each != [0, ""]} == {}
    assert len(said["uses"]) > 4
    for command, (code, sentence) in said["uses"].items():
        assert code == 1, (command, sentence)
        assert sentence.startswith("biosensor-gateway: liblsl, the library"), command
        assert sentence.count("\n") == 1, command
        assert "pip install" in sentence or "PYLSL_LIB" in sentence, command
