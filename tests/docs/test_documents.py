"""The documents agree with the code and with each other."""

from __future__ import annotations

import ast
import re
import shlex
import shutil
import textwrap
from collections import Counter
from collections.abc import Iterator
from functools import cache
from itertools import chain
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import pytest
from typer.core import TyperGroup

from biosensor_gateway.cli.app import Deferred, app
from biosensor_gateway.devices.registry import declaration, declaration_names, settings_models
from biosensor_gateway.settings import file as settings_file
from tests.docs.generate import PARTS, ROOT, Part, main, updated

DECISIONS = sorted((ROOT / "docs" / "decisions").glob("*/*.md"))
DOCUMENTS = [
    *(ROOT / name for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md")),
    *sorted((ROOT / "docs").glob("*.md")),
    *sorted((ROOT / "docs" / "sensors").glob("*.md")),
    ROOT / "docs" / "decisions" / "README.md",
    *DECISIONS,
]

_BLOCK = re.compile(r"^ *```(?P<language>\w*)\n(?P<body>.*?)^ *```$", re.DOTALL | re.MULTILINE)
_SHELLS = {"sh", "bat"}
_LINK = re.compile(r"\]\((?P<target>[^)\s]+)\)")
_INLINE_COMMAND = re.compile(r"`((?:make|biosensor-gateway) [^`]+)`")
# Folders in which people work; a document names paths inside the repository.
_MACHINE_PATH = re.compile(r"(?<![\w.~<])/(?:work|root|home|tmp|Users)/|[A-Z]:\\")


def _name(document: Path) -> str:
    return document.relative_to(ROOT).as_posix()


each_document = pytest.mark.parametrize("document", DOCUMENTS, ids=_name)


def _commands(text: str) -> Iterator[list[str]]:
    """Yield the words of every command in shell blocks and in inline code."""
    for block in _BLOCK.finditer(text):
        if block["language"] in _SHELLS:
            for line in block["body"].splitlines():
                yield shlex.split(line.replace("\\", "/"), comments=True)
    for inline in _INLINE_COMMAND.findall(re.sub(r"\s*\n\s*", " ", text)):
        yield shlex.split(inline)


def _prose(text: str) -> str:
    return _BLOCK.sub("", text)


def _anchors(document: Path) -> set[str]:
    headings = re.findall(r"^#+ (.+)$", _prose(document.read_text(encoding="utf-8")), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def _fault(words: list[str]) -> str:
    """Say what is wrong with a command; empty for a good one, and for one that is not ours."""
    match words:
        case ["make", target, *_]:
            return "" if re.search(rf"^{target}:", _makefile(), re.MULTILINE) else "no such target"
        case ["biosensor-gateway", *arguments]:
            return _cli_fault(arguments)
        case ["ros2", "run", "lsl_to_ros", program, *_]:
            setup = (ROOT / "ros_side" / "lsl_to_ros" / "setup.py").read_text(encoding="utf-8")
            return "" if f'"{program} = ' in setup else "no such program"
        case ["ros2", "launch", "lsl_to_ros", file, *arguments]:
            return _launch_fault(ROOT / "ros_side" / "lsl_to_ros" / "launch" / file, arguments)
        case _:
            return _path_fault(words)


def _makefile() -> str:
    return (ROOT / "Makefile").read_text(encoding="utf-8")


def _cli_fault(arguments: list[str]) -> str:
    command: Any = app()
    while arguments and isinstance(command, TyperGroup) and not arguments[0].startswith("-"):
        name, *arguments = arguments
        # In a group with a default, what is no command is an argument of that one.
        default: str = getattr(command, "default", "")
        found = command.commands.get(name) or command.commands.get(default)
        if found is None:
            return f"no such command: {name}"
        command = found.load() if isinstance(found, Deferred) else found
    known = {option for parameter in command.params for option in parameter.opts}
    unknown = [word for word in arguments if word.startswith("-") and word not in known]
    return f"no such options: {unknown}" if unknown else ""


def _launch_fault(file: Path, arguments: list[str]) -> str:
    if not file.is_file():
        return "no such launch file"
    of_every_node = ROOT / "ros_side" / "lsl_to_ros" / "lsl_to_ros" / "launch_description.py"
    text = file.read_text(encoding="utf-8") + of_every_node.read_text(encoding="utf-8")
    given = [argument.partition(":=")[0] for argument in arguments]
    known = set(re.findall(r'"(\w+)"', text))
    unknown = [name for name in given if name not in known]
    return f"no such arguments: {unknown}" if unknown else ""


def _path_fault(words: list[str]) -> str:
    ours = [word for word in words if re.match(r"(tests|requirements|docs|common)/", word)]
    missing = [word for word in ours if not (ROOT / word).exists()]
    return f"no such files: {missing}" if missing else ""


@pytest.mark.parametrize(
    "document",
    # Decisions are not rewritten, so an old one may name what is gone.
    [each for each in DOCUMENTS if each not in DECISIONS],
    ids=_name,
)
def test_every_command_exists(document: Path) -> None:
    commands = list(_commands(document.read_text(encoding="utf-8")))
    faults = {shlex.join(words): fault for words in commands if (fault := _fault(words))}
    assert not faults


def test_commands_are_found_at_all() -> None:
    texts = [document.read_text(encoding="utf-8") for document in DOCUMENTS]
    found = {words[0] for text in texts for words in _commands(text) if words}
    assert {"make", "biosensor-gateway", "ros2", "pip"} <= found


@pytest.mark.parametrize(
    "command",
    [
        "make no-such-target",
        "biosensor-gateway scan-everything",
        "biosensor-gateway config nothing",
        "biosensor-gateway run --no-such-option",
        "ros2 run lsl_to_ros other",
        "ros2 launch lsl_to_ros other.launch.py",
        "ros2 launch lsl_to_ros lsl_to_ros.launch.py colour:=red",
        "pip install -r requirements/none.txt",
    ],
)
def test_a_command_that_does_not_exist_is_noticed(command: str) -> None:
    assert _fault(shlex.split(command))


@each_document
def test_every_relative_link_resolves(document: Path) -> None:
    broken: list[str] = []
    for target in _LINK.findall(_prose(document.read_text(encoding="utf-8"))):
        if "://" in target:
            continue
        path, _, anchor = unquote(target).partition("#")
        file = (document.parent / path).resolve() if path else document
        if not file.exists() or (anchor and anchor not in _anchors(file)):
            broken.append(target)
    assert not broken


@each_document
def test_every_step_of_a_list_begins_a_line(document: Path) -> None:
    text = _prose(document.read_text(encoding="utf-8"))
    steps = re.findall(r"^ *(\d+)\. (.+(?:\n *[^\s\d#|-].*)*)", text, re.MULTILINE)
    assert [n for n, step in steps if re.search(rf"\s{int(n) + 1}\. [A-Z*`\[]", step)] == []


@each_document
def test_no_line_names_a_path_of_one_machine(document: Path) -> None:
    lines = document.read_text(encoding="utf-8").splitlines()
    assert not [line for line in lines if _MACHINE_PATH.search(line)]


@pytest.mark.parametrize("folder", ["work", "root", "home", "tmp", "Users"])
def test_a_path_of_one_machine_is_noticed(folder: str) -> None:
    assert _MACHINE_PATH.search(f"see `/{folder}/me/file` for more")
    assert not _MACHINE_PATH.search(f"see `~/{folder}/file`, `docs/{folder}/file` for more")


def test_migration_has_a_row_for_every_topic_of_the_original() -> None:
    text = (ROOT / "docs" / "migration.md").read_text(encoding="utf-8")
    missing = [
        topic
        for name in declaration_names()
        for stream in declaration(name).streams
        if stream.contract
        and (topic := f"| `{name}/{stream.data_name}` | {stream.message_type.rpartition('/')[2]} |")
        not in text
    ]
    assert not missing


def test_decisions_are_few_and_each_title_is_there_once() -> None:
    titles = {path.read_text(encoding="utf-8").partition("\n")[0] for path in DECISIONS}
    assert len(titles) == len(DECISIONS) <= 50


@pytest.mark.parametrize("decision", DECISIONS, ids=_name)
def test_a_decision_has_its_parts_on_one_page(decision: Path) -> None:
    text = decision.read_text(encoding="utf-8")
    parts = re.findall(r"^## (.+)$", text, re.MULTILINE)
    assert parts == ["Context", "Decision", "Consequences"]
    assert len(text.split()) <= 400


@each_document
def test_every_example_of_settings_loads(document: Path, tmp_path: Path) -> None:
    for block in _BLOCK.finditer(document.read_text(encoding="utf-8")):
        text = textwrap.dedent(block["body"])
        if block["language"] == "toml" and "[[device]]" in text:
            path = tmp_path / "settings.toml"
            path.write_text(text, encoding="utf-8")
            assert settings_file.load_settings(path, settings_models()).devices


# What the sensors' pages quote is what the program says.

PAGES = sorted((ROOT / "docs" / "sensors").glob("*.md"))
SAYING = ("common/biosensor_common", "gateway_win/biosensor_gateway")

HOLE = "…"
# The first cell of a table of symptoms; a quotation is a sentence, not a name.
_TABLE = re.compile(r"^\| Symptom \|.*\n\|[-| ]+\|\n((?:\|.*\n)+)", re.MULTILINE)
_CELL = re.compile(r"^\| (.+?) \|", re.MULTILINE)
_QUOTED = re.compile(r"`([^`]+ [^`]+ [^`]+)`")
_COMMAND = "biosensor-gateway "
# Of the letters of a quotation, so many must be the program's own; the rest stands where the
# program fills in a name.
_OWN = 0.6
_SHORTEST = 4


def quotations(page: Path) -> list[str]:
    cells = (_CELL.findall(table) for table in _TABLE.findall(page.read_text("utf-8")))
    found = (_QUOTED.match(cell) for cell in chain.from_iterable(cells))
    return [each[1] for each in found if each and not each[1].startswith(_COMMAND)]


@cache
def said() -> dict[str, frozenset[str]]:
    """All texts of the program, with a hole where it fills something in, and their words."""
    found: set[str] = set()
    for folder in SAYING:
        for path in (ROOT / folder).rglob("*.py"):
            if "simulator" not in path.parts and "simulation" not in path.parts:
                found |= _texts(ast.parse(path.read_text("utf-8")))
    # A quotation cannot have the quotes that the program puts around a setting.
    plain = (text.replace("`", "") for text in found)
    return {text: _words(text) for text in plain if len(text.replace(HOLE, "")) >= _SHORTEST}


def _texts(tree: ast.Module) -> set[str]:
    # Docstrings are not said to anybody.
    silent = {node.value for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    texts: dict[ast.AST, str] = {}
    for scope in ast.walk(tree):
        # Functions come after what they are in, so that the nearest names are taken.
        if isinstance(scope, ast.Module | ast.FunctionDef | ast.AsyncFunctionDef):
            inside = list(ast.walk(scope))
            names = {} if isinstance(scope, ast.Module) else _names(inside)
            said = (each for each in inside if isinstance(each, ast.Constant | ast.JoinedStr))
            texts |= {each: _text(each, names) for each in said if each not in silent}
    return set(texts.values())


def _names(nodes: list[ast.AST]) -> dict[str, str]:
    """The texts of the names that are given one only."""
    given = [
        (target.id, _text(each.value, {}))
        for each in nodes
        if isinstance(each, ast.Assign)
        for target in each.targets
        if isinstance(target, ast.Name)
    ]
    count = Counter(name for name, _ in given)
    return {name: text for name, text in given if count[name] == 1}


def _text(node: ast.AST, names: dict[str, str]) -> str:
    """A text as it is written; a name in it stands for the text that was put together before."""
    if isinstance(node, ast.Constant):
        return str(node.value)
    if isinstance(node, ast.JoinedStr):
        return "".join(_text(each, names) for each in node.values)
    if isinstance(node, ast.FormattedValue) and isinstance(node.value, ast.Name):
        return names.get(node.value.id, HOLE)
    return HOLE


def own(quoted: str, template: str) -> int:
    """Most letters of a quotation that a text has itself; -1 if it cannot have come from it.

    A hole of either stands for anything, also for a part of the other.
    """
    # row[j]: the best for quoted[:i], where the text has been read up to j.
    row = [0] * (len(template) + 1)
    for letter in quoted:
        row = _after(letter, row, template)
    return max(row)


def _after(letter: str, row: list[int], template: str) -> list[int]:
    following = [-1] * len(row)
    for j, best in enumerate(row):
        if letter == HOLE:
            following[j] = max(best, following[j - 1] if j else -1)
            continue
        if j < len(template) and template[j] == HOLE and best >= 0:
            following[j] = max(following[j], best)
        if j and template[j - 1] == HOLE:
            following[j] = max(following[j], following[j - 1])
        if j and template[j - 1] == letter and row[j - 1] >= 0:
            following[j] = max(following[j], row[j - 1] + 1)
    return following


def is_said(quoted: str) -> bool:
    needed = _OWN * len(quoted.replace(HOLE, ""))
    words = _words(quoted)
    # Only what has words in common is compared letter by letter.
    near = (text for text, has in said().items() if 2 * len(words & has) >= len(words))
    return any(own(quoted, text) >= needed for text in near)


def _words(text: str) -> frozenset[str]:
    return frozenset(re.findall(r"\w{2,}", text))


@pytest.mark.parametrize("page", PAGES, ids=lambda path: path.stem)
def test_every_sentence_is_one_that_the_program_says(page: Path) -> None:
    # Many are put together: what is the case; what to do.
    wrong = [
        each
        for each in quotations(page)
        if not is_said(each) and not all(is_said(part) for part in each.split("; "))
    ]
    assert wrong == []


def test_pages_quote_something() -> None:
    assert sum(len(quotations(page)) for page in PAGES) > 60


@pytest.mark.parametrize(
    ("quoted", "template", "fits"),
    [
        ("no port; open it", "no port; open it", True),
        ("no port", "there is no port; open it", True),
        ("several Polar H10 are in range (…)", "several … are in range (…): …", True),
        ("no data of … for … s; enabling again", "no data of … for … s; enabling again", True),
        ("it refuses … and more", "it refuses everything and more", True),
        ("no port; close it", "no port; open it", False),
        ("the dongle is full", "the dongle is empty", False),
        ("the dongle is full", "…", False),
    ],
)
def test_how_quotations_are_compared(quoted: str, template: str, fits: bool) -> None:
    needed = _OWN * len(quoted.replace(HOLE, ""))
    assert (own(quoted, template) >= needed) is fits


README = ROOT / "README.md"
REFERENCE = ROOT / "docs" / "ros-reference.md"
MAX_README_LINES = 150


def test_everything_that_is_generated_is_up_to_date() -> None:
    stale = [
        part.document
        for part in PARTS
        if updated(text := (ROOT / part.document).read_text(encoding="utf-8"), part) != text
    ]
    assert not stale, f"run: make docs ({stale})"


def test_a_table_that_was_edited_is_found_and_fixed(tmp_path: Path) -> None:
    for part in PARTS:
        (tmp_path / part.document).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / part.document, tmp_path / part.document)
    edited = tmp_path / "docs" / "topics.md"
    right = edited.read_text(encoding="utf-8")
    edited.write_text(right.replace("| `zephyr/hr` | UInt8", "| `zephyr/hr` | UInt16"), "utf-8")

    with pytest.raises(SystemExit, match=r"out of date: docs/topics.md; run: make docs"):
        main(["--check", "--root", str(tmp_path)])
    main(["--root", str(tmp_path)])
    assert edited.read_text(encoding="utf-8") == right


@pytest.mark.parametrize("part", [part for part in PARTS if part.name], ids=lambda part: part.name)
def test_a_document_without_markers_is_refused(part: Part) -> None:
    with pytest.raises(ValueError, match="must be there once each"):
        updated("no markers\n", part)


def test_the_readme_is_a_page() -> None:
    assert len(README.read_text(encoding="utf-8").splitlines()) <= MAX_README_LINES


def test_the_reference_names_every_parameter_with_its_default() -> None:
    parameters = pytest.importorskip("lsl_to_ros.parameters.streams")
    text = REFERENCE.read_text(encoding="utf-8")
    for name, value in parameters.DEFAULTS.items():
        assert f"| `{name}` | `{str(value).lower()}` |" in text
    assert f"1 to {parameters.LENGTH_RANGE[-1]}" in text
