"""Words that are never right here, in code or in documents: the field has a plainer one."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
INSTEAD = {
    r"anew": "again",
    r"mend(s|ed|ing)?": "fix",
    r"one a (device|stream|sensor)": "one per device",
}
FOLDERS = ("benchmarks", "common", "docs", "examples", "gateway_win", "installer", "ros_side")
ENDINGS = {".py", ".md", ".js", ".html", ".nsi", ".ps1"}
_WORD = re.compile(rf"(?<![A-Za-z])({'|'.join(INSTEAD)})(?![A-Za-z])", re.IGNORECASE)


@pytest.mark.parametrize("folder", FOLDERS)
def test_a_plainer_word_stands_instead(folder: str) -> None:
    found = [
        f"{path.relative_to(ROOT)}:{number}: {match[0]}"
        for path in sorted((ROOT / folder).rglob("*"))
        if path.suffix in ENDINGS and "vendor" not in path.parts and path.is_file()
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1)
        if (match := _WORD.search(line))
    ]
    assert not found, f"{INSTEAD}: {found}"
