"""How the code is written: broad excepts, words, the heads of modules."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

# Whoever catches everything says in the same line why; CONTRIBUTING.md says where that may be.
ROOT = Path(__file__).parents[2]
PACKAGES = ("common", "gateway_win", "ros_side")
BROAD = {"Exception", "BaseException"}
# Only a text that has one of these is worth parsing.
BROADLY = re.compile(r"except\b|suppress\(")
# The part behind the rule that ruff is told to leave out, of so many words at least.
REASON = re.compile(r"#(?: noqa: BLE001 -)?(?! noqa)(?: \S+){4,}$")


def _is_broad(caught: ast.expr | None) -> bool:
    if isinstance(caught, ast.Tuple):
        return any(map(_is_broad, caught.elts))
    return caught is None or (isinstance(caught, ast.Name) and caught.id in BROAD)


def _broad_lines(source: str) -> Iterator[str]:
    """Give the lines that catch or suppress everything."""
    lines = source.splitlines()
    for node in ast.walk(ast.parse(source)):
        match node:
            case ast.ExceptHandler(type=caught):
                is_broad = _is_broad(caught)
            case ast.Call(
                func=ast.Name(id="suppress") | ast.Attribute(attr="suppress"), args=suppressed
            ):
                is_broad = any(map(_is_broad, suppressed))
            case _:
                continue
        if is_broad:
            yield lines[node.lineno - 1]


def _without_reason(source: str) -> list[str]:
    return [line.strip() for line in _broad_lines(source) if not REASON.search(line)]


@pytest.mark.parametrize("package", PACKAGES)
def test_each_broad_except_has_its_reason_in_its_line(package: str) -> None:
    modules = [path for path in (ROOT / package).rglob("*.py") if "build" not in path.parts]
    assert modules
    bare = {
        str(path.relative_to(ROOT)): found
        for path in modules
        if BROADLY.search(text := path.read_text("utf-8")) and (found := _without_reason(text))
    }
    assert bare == {}


# Words that are never right here, in code or in documents: the field has a plainer one.
INSTEAD = {
    r"anew": "again",
    r"mend(s|ed|ing)?": "fix",
    r"(once|one|value|sample)s? a (device|stream|sensor|sample|channel|row|line)": "one per device",
    r"(row|line|column|byte)s? a (device|stream|sensor|sample|channel|value)": "a row per sample",
    r"(the|its|from) begin": "start",
    r"for ever": "forever",
    r"be had": "be available",
    r"hand(s|ed) on": "pass on",
    r"in the place of": "instead of",
    r"cut short": "truncated",
    r"a damage": "damaged bytes",
    r"without a word": "silently",
    r"so-called": "(nothing)",
    r"(it|which|what|who) is no (?!longer|matter)[a-z]+": "is not a",
    r"taken for": "mistaken for, treated as",
    r"(an?|the) own": "its own",
    r"(what|who) stands": "the text that is",
    r"(comes?|came) along": "is included",
    r"who is who": "the list of names",
    r"in truth": "really",
    r"till": "until",
    r"(none but|save for)": "only, except",
    r"in vain": "without success",
    r"(expected|listed|needed) are": "verb after subject",
    r"once for all": "once",
    r"informations": "information",
    r"in the manner of": "like",
    r"crystal": "oscillator",
    r"(hitherto|lest|thereof|therewith|whence|whereby|wherein)": "a plain word",
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


# Each module says first what it does or holds, in words that a stranger can look for.
PRODUCT = ("common", "gateway_win", "ros_side", "installer")
# "What a strap sends" makes a reader look on for whether it is sent, read or described here.
QUESTIONS = {"how", "what", "when", "where", "whether", "which", "who", "why"}


def _modules(folder: str) -> list[Path]:
    modules = [path for path in (ROOT / folder).rglob("*.py") if "build" not in path.parts]
    assert modules
    return modules


def _docstring(source: str) -> str:
    """Return a module's docstring; it is the first thing but for comments."""
    found = re.match(r'(?:#[^\n]*\n|\s)*r?"""(.*?)"""', source, re.DOTALL)
    return found[1].strip() if found else ""


@pytest.mark.parametrize("folder", PRODUCT)
def test_a_module_begins_with_no_question(folder: str) -> None:
    said = {path: _docstring(path.read_text("utf-8")) for path in _modules(folder)}
    questions = [
        f"{path.relative_to(ROOT)}: {text.splitlines()[0]}"
        for path, text in said.items()
        if text and text.split()[0].strip(",:").lower() in QUESTIONS
    ]
    assert questions == []
