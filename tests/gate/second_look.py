"""Run tests; run the few that failed once more, by themselves, and name them.

See decision 27: devices, radios and clocks run in real time on a machine that others
use, too. Nothing is allowed the second time that is not allowed the first, and no test
passes so without being named, on the screen and in a file.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

MOST = 5
"""More failures than these are not looked at again: the machine is not to blame."""
NAMES = "passed-at-second-look.txt"
_OK, _TESTS_FAILED = 0, 1


def run(arguments: Sequence[str], folder: Path) -> int:
    """Run pytest with these arguments.

    Parameters
    ----------
    arguments
        Of pytest.
    folder
        Where the names go of the tests that passed only at the second look; they are
        added to the file that is there.

    Returns
    -------
    int
        Exit code of pytest: of the second run if there was one, else of the first.
    """
    with tempfile.TemporaryDirectory() as cache:
        code = _pytest(arguments, cache)
        failed = _failed(Path(cache)) if code == _TESTS_FAILED else []
        if not 0 < len(failed) <= MOST:
            return code
        _say("These failed, and are run once more, by themselves:", failed)
        # Without the arguments that choose and distribute: exactly these, one after the other.
        code = _pytest(["-m", "", *failed], cache)
    if code == _OK:
        _say("These failed at first, and passed by themselves:", failed)
        folder.mkdir(parents=True, exist_ok=True)
        with (folder / NAMES).open("a", encoding="utf-8") as names:
            names.writelines(f"{name}\n" for name in failed)
    return code


def _pytest(arguments: Sequence[str], cache: str) -> int:
    command = [sys.executable, "-m", "pytest", "-o", f"cache_dir={cache}", *arguments]
    return subprocess.run(command, check=False).returncode


def _failed(cache: Path) -> list[str]:
    written = cache / "v" / "cache" / "lastfailed"
    return sorted(json.loads(written.read_text(encoding="utf-8"))) if written.exists() else []


def _say(sentence: str, names: Sequence[str]) -> None:
    print(f"\n{sentence}", *names, sep="\n  ", flush=True)
