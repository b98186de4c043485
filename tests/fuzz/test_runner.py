"""``python -m tests.fuzz`` finds a planted fault, keeps its input and says so."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from tests.fuzz import campaign, hanging, planted
from tests.fuzz.contract import load, strictly
from tests.fuzz.engine import has_atheris

pytestmark = pytest.mark.nightly

PLANTED = "tests.fuzz.planted"
# A find ends the run; only a busy machine needs more than two seconds.
PATIENCE_S = 60
ENGINES = ["--blind", *(["--seconds=60"] if has_atheris() else [])]


def run(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "tests.fuzz", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=170, check=False)


def corpus(folder: Path, name: str, data: bytes) -> Path:
    (folder / name).mkdir(parents=True)
    (folder / name / "seed").write_bytes(data)
    return folder


@pytest.mark.parametrize("engine", ENGINES)
def test_a_fault_is_found_from_a_harmless_input(engine: str, tmp_path: Path) -> None:
    with strictly():
        planted.check(planted.HARMLESS)
    seeds = corpus(tmp_path / "corpus", "planted", planted.HARMLESS)
    finds = tmp_path / "finds"
    done = run(engine, f"--seconds={PATIENCE_S}", f"--corpus={seeds}", f"--finds={finds}", PLANTED)
    assert done.returncode == 1, done.stdout + done.stderr
    (find,) = (finds / PLANTED).glob("crash-*")
    assert f"FIND in {PLANTED}" in done.stdout
    assert "ValueError: no clock reads" in done.stdout
    assert str(find) in done.stdout
    assert done.stdout.endswith("0 passed, 1 failed\n")
    with strictly(), pytest.raises(ValueError, match="no clock reads"):
        load(PLANTED).check(find.read_bytes())


def test_a_fault_that_the_corpus_shows_is_a_find_at_once(tmp_path: Path) -> None:
    seeds = corpus(tmp_path / "corpus", "planted", b"E4_Bvp 1680442024644790 21\n")
    done = run("--seconds=0", f"--corpus={seeds}", f"--finds={tmp_path / 'finds'}", PLANTED)
    assert done.returncode == 1, done.stdout + done.stderr


def test_a_hang_is_a_find_and_its_input_is_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Its process starts in about one second; only a busy machine takes longer. All of it is
    # waited out.
    monkeypatch.setattr(campaign, "_GRACE_S", 20.0)
    seeds = corpus(tmp_path / "corpus", "hanging", hanging.HARMFUL)
    finds = tmp_path / "finds"
    (outcome,) = campaign.run(["tests.fuzz.hanging"], 0.0, finds, corpus=seeds, blind=True)
    assert not outcome.is_good
    assert outcome.reason.startswith("it hangs")
    assert outcome.find is not None
    assert outcome.find.read_bytes() == hanging.HARMFUL
