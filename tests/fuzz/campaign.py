"""Runs the targets one after the other, each in a process of its own."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from tests.fuzz.blind import RUNNING
from tests.fuzz.contract import RAISED, corpus_of, inputs

FINDS = ("crash-", "timeout-", "oom-", "leak-")
"""What the names of finds begin with."""

# To start and to replay the corpus, also on a machine that is busy with more than this.
_GRACE_S = 120.0
_EXECUTED = re.compile(r"stat::number_of_executed_units: (\d+)")
_COVERED = re.compile(r"cov: (\d+) ")
_RAISED = re.compile(f"^{RAISED}(.*)$", re.MULTILINE)
_LONGEST_REASON = 300


class Outcome(NamedTuple):
    """What became of one target."""

    name: str
    seconds: float  # From start to end of its process.
    executed: int  # Inputs that were tried.
    covered: int | None  # Places of the code that were reached; None without coverage.
    find: Path | None  # The input that broke the contract, None if there is none.
    reason: str  # Why it is a find, or why the target could not be tried; empty if all is well.

    @property
    def is_good(self) -> bool:
        """Whether nothing was found, and something was tried."""
        return not self.reason


def run(
    names: Sequence[str],
    seconds: float,
    folder: Path,
    *,
    corpus: Path | None = None,
    blind: bool = False,
    seed: int = 0,
) -> Iterator[Outcome]:
    """Fuzz each target for its share of the time that is left; start-up counts.

    Parameters
    ----------
    folder
        Where finds, logs and grown corpora go, a folder for each target.
    corpus
        Where the inputs to begin with are, a folder for each target; None for its own.
    blind
        Use hypothesis even where atheris runs.
    seed
        Of what is drawn; 0 for another one in each run.
    """
    engine = _engine(seed, blind=blind)
    end = time.time() + seconds
    for place, name in enumerate(names):
        share = max(0.0, end - time.time()) / (len(names) - place)
        known = corpus_of(name) if corpus is None else corpus / name.rpartition(".")[2]
        yield _try(name, share, folder / name, known, engine)


class _Engine(NamedTuple):
    """How its process is started."""

    options: Sequence[str]
    environment: Mapping[str, str]


def _engine(seed: int, *, blind: bool) -> _Engine:
    # Sets of text have another order in each process, and so have the places that are reached.
    order = {"PYTHONHASHSEED": str(seed)} if seed else {}
    options = ["--seed", str(seed), *(["--blind"] if blind else [])]
    return _Engine(options, os.environ | order)


def _try(name: str, seconds: float, finds: Path, corpus: Path, engine: _Engine) -> Outcome:
    finds.mkdir(parents=True, exist_ok=True)
    old = set(inputs(finds))
    begin = time.time()
    command = [sys.executable, "-m", "tests.fuzz.engine", name, str(finds), str(corpus)]
    command += ["--until", repr(begin + seconds), *engine.options]
    log = finds / "log.txt"
    with log.open("wb") as output:
        try:
            code = subprocess.run(
                command,
                stdout=output,
                stderr=output,
                timeout=seconds + _GRACE_S,
                check=False,
                env=engine.environment,
            ).returncode
        except subprocess.TimeoutExpired:
            code = None
    said = log.read_text(encoding="utf-8", errors="replace")
    new = [path for path in inputs(finds) if path not in old and path.name.startswith(FINDS)]
    find = new[0] if new else _left_behind(finds)
    covered = _COVERED.findall(said)
    executed = _EXECUTED.findall(said)
    return Outcome(
        name,
        time.time() - begin,
        int(executed[-1]) if executed else 0,
        int(covered[-1]) if covered else None,
        find,
        "" if code == 0 else _reason(code, said, log),
    )


def _left_behind(finds: Path) -> Path | None:
    """Keep the input at which a process without coverage hung or died."""
    running = finds / RUNNING
    return running.rename(finds / f"timeout-{time.time_ns()}") if running.exists() else None


def _reason(code: int | None, said: str, log: Path) -> str:
    if code is None or "ERROR: libFuzzer: timeout" in said:
        return "it hangs"
    raised = _RAISED.findall(said)
    text = raised[-1] if raised else f"its process ended with exit code {code}; see {log}"
    return text[:_LONGEST_REASON]
