"""Tries one target in this process: ``python -m tests.fuzz.engine TARGET FINDS CORPUS...``.

A process ends with the first input that is a find: libFuzzer cannot go on, and what a
find leaves behind must not disturb the next target. `tests.fuzz.campaign` starts it.
"""

from __future__ import annotations

import argparse
import importlib
import importlib.util
import sys
import time
from pathlib import Path
from typing import Any, cast

from tests.fuzz.contract import DICTIONARY, Target, load, strictly, telling

MAX_BYTES = 4096
"""Longer inputs are in the corpora where they matter; they would only make mutation slow."""
MAX_SECONDS_AN_INPUT = 10
_MAX_MEGABYTES = 2048
GROWN = "grown"
"""Folder, beside the finds, of inputs that reached something new."""
GUIDES = ("biosensor_common", "biosensor_gateway", "lsl_to_ros", "tomllib", "configparser")
"""Packages whose coverage guides; the standard library's readers among them."""


def has_atheris() -> bool:
    """Whether the coverage-guided fuzzer is installed."""
    return importlib.util.find_spec("atheris") is not None


def _guided(
    fuzzer: Any, name: str, finds: Path, corpora: list[Path], until: float, seed: int
) -> None:
    """Run libFuzzer, which ends this process, with an exit code other than 0 for a find."""
    with fuzzer.instrument_imports(include=list(GUIDES)):
        target = load(name)
    seconds = max(1, round(until - time.time()))
    grown = finds / GROWN
    grown.mkdir(parents=True, exist_ok=True)
    options = [
        f"-artifact_prefix={finds}/",
        f"-max_total_time={seconds}",
        f"-max_len={MAX_BYTES}",
        f"-dict={DICTIONARY}",
        f"-timeout={MAX_SECONDS_AN_INPUT}",
        f"-rss_limit_mb={_MAX_MEGABYTES}",
        f"-seed={seed}",
        "-print_final_stats=1",
    ]
    fuzzer.Setup([sys.argv[0], *options, str(grown), *map(str, corpora)], telling(target.check))
    with strictly():
        fuzzer.Fuzz()


def _blind(target: Target, finds: Path, corpora: list[Path], until: float, seed: int) -> int:
    from tests.fuzz import blind  # noqa: PLC0415 - only this engine needs hypothesis

    with strictly():
        return blind.fuzz(target, finds, corpora, until, seed)


def main() -> int:
    """Try the target; exit code 0 if nothing was found."""
    arguments = argparse.ArgumentParser(prog="tests.fuzz.engine")
    arguments.add_argument("target")
    arguments.add_argument("finds", type=Path)
    arguments.add_argument("corpora", type=Path, nargs="+")
    arguments.add_argument("--until", type=float, default=0.0, help="unix time")
    arguments.add_argument("--seed", type=int, default=0, help="0: another one in each run")
    arguments.add_argument("--blind", action="store_true", help="without coverage")
    given = arguments.parse_args()
    finds = cast("Path", given.finds).resolve()
    finds.mkdir(parents=True, exist_ok=True)
    corpora = [folder for folder in cast("list[Path]", given.corpora) if folder.is_dir()]
    if given.blind or not has_atheris():
        return _blind(load(given.target), finds, corpora, given.until, given.seed)
    # It comes without types, and not for every platform.
    fuzzer: Any = importlib.import_module("atheris")
    _guided(fuzzer, given.target, finds, corpora, given.until, given.seed)
    return 0


if __name__ == "__main__":
    sys.exit(main())
