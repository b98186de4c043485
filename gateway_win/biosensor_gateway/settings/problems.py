"""Describes problems of the settings, with the line of each key.

Parsers return values without lines, so that `key_lines` scans the text for the keys.
:mod:`tomllib` has accepted the text before, and the scanner only has to distinguish keys
from values. Grammar: TOML 1.0.0, toml.io/en/v1.0.0.
"""

from __future__ import annotations

import os
import re
import tomllib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple, cast

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from biosensor_common.errors import ConfigError, ConfigReason, did_you_mean
from biosensor_gateway.settings.models import (
    OVERRIDE_DELIMITER,
    OVERRIDE_PREFIX,
    environment_overrides,
)

KeyPath = tuple[str | int, ...]
"""Keys from the root to a value; an array contributes the index, from 0."""

_TOKEN = re.compile(
    r'''
    (?P<text>   """(?:\\.|[^\\])*?""""{0,2} | \'\'\'.*?\'\'\'\'{0,2}
              | "(?:\\.|[^"\\\n])*"         | '[^'\n]*' )
  | (?P<blank>  [ \t\r]+ | \#[^\n]* )
  | (?P<mark>   [\n\[\]{}=,.] )
  | (?P<word>   [^\s\[\]{}=,."'\#]+ )
    ''',
    re.VERBOSE | re.DOTALL,
)
_END_OF_SCALAR = frozenset("\n,]}")


class _Token(NamedTuple):
    text: str
    line: int


_END = _Token("", 0)


def _tokens(text: str) -> Iterator[_Token]:
    line = 1
    for match in _TOKEN.finditer(text):
        if match.lastgroup != "blank":
            yield _Token(match.group(), line)
        line += match.group().count("\n")


class _Scanner:
    def __init__(self, text: str) -> None:
        self._tokens = _tokens(text)
        self._current = next(self._tokens, _END)
        self._lengths: dict[KeyPath, int] = {}
        self.lines: dict[KeyPath, int] = {}

    def scan(self) -> None:
        table: KeyPath = ()
        while self._current is not _END:
            if self._current.text == "\n":
                self._take()
            elif self._current.text == "[":
                table = self._header()
            else:
                self._assignment(table)

    def _take(self) -> _Token:
        taken = self._current
        self._current = next(self._tokens, _END)
        return taken

    def _skip(self, marks: str) -> None:
        while self._current.text and self._current.text in marks:
            self._take()

    def _note(self, path: KeyPath, line: int) -> KeyPath:
        self.lines.setdefault(path, line)
        return path

    def _key(self) -> Iterator[tuple[str, int]]:
        while True:
            token = self._take()
            # A quoted key can have escapes, which the parser resolves.
            yield next(iter(tomllib.loads(f"{token.text} = 0"))), token.line
            if self._current.text != ".":
                return
            self._take()

    def _header(self) -> KeyPath:
        self._take()
        is_element = self._current.text == "["
        self._skip("[")
        path: KeyPath = ()
        line = 0
        for part, line in self._key():
            # A header below an array of tables belongs to its last element.
            length = self._lengths.get(path, 0)
            path = self._note((*path, length - 1, part) if length else (*path, part), line)
        if is_element:
            index = self._lengths.get(path, 0)
            self._lengths[path] = index + 1
            path = self._note((*path, index), line)
        self._skip("]")
        return path

    def _assignment(self, table: KeyPath) -> None:
        path = table
        for part, line in self._key():
            path = self._note((*path, part), line)
        self._skip("=")
        self._value(path)

    def _value(self, path: KeyPath) -> None:
        if self._current.text == "[":
            self._array(path)
        elif self._current.text == "{":
            self._inline_table(path)
        else:
            while self._current is not _END and self._current.text not in _END_OF_SCALAR:
                self._take()

    def _array(self, path: KeyPath) -> None:
        self._take()
        self._skip("\n")
        index = 0
        while self._current.text != "]":
            self._value(self._note((*path, index), self._current.line))
            self._skip("\n,")
            index += 1
        self._take()

    def _inline_table(self, path: KeyPath) -> None:
        self._take()
        self._skip("\n")
        while self._current.text != "}":
            self._assignment(path)
            self._skip("\n,")
        self._take()


def key_lines(text: str) -> dict[KeyPath, int]:
    """Find the line of every key.

    Parameters
    ----------
    text
        TOML that :func:`tomllib.loads` accepts.

    Returns
    -------
    dict
        Line, from 1, of every table, key and array element where it first
        appears. The element *i* of the array of tables *a* is ``("a", i)``.
    """
    scanner = _Scanner(text)
    scanner.scan()
    return scanner.lines


_EXPECTED = {
    "string_type": "should be text in quotes",
    "int_type": "should be an integer",
    "float_type": "should be a number",
    "bool_type": "should be true or false",
    "tuple_type": "should be a list in square brackets",
    "list_type": "should be a list in square brackets",
    "model_type": "should be a table",
}
_SUBJECT = re.compile(r"(?:Input|String|Tuple|List|Value error,) ")
_LONGEST_SHOWN = 40


class Problem(NamedTuple):
    """One thing to correct.

    ``variable`` is the environment variable that has it, empty for the file;
    ``other`` is a second place in the file that conflicts with it.
    """

    reason: ConfigReason
    path: KeyPath
    text: str
    variable: str = ""
    other: KeyPath | None = None


def report(path: Path, lines: Mapping[KeyPath, int], problems: Sequence[Problem]) -> ConfigError:
    """Return one error for all problems, those of the file first and in its order.

    Parameters
    ----------
    lines
        Lines of its keys, from `key_lines`.
    problems
        At least one.
    """
    ordered = sorted(problems, key=lambda found: (bool(found.variable), _line(found.path, lines)))
    sentences = [_sentence(path, lines, found) for found in ordered]
    return ConfigError(ordered[0].reason, "\n".join(sentences))


def _sentence(path: Path, lines: Mapping[KeyPath, int], problem: Problem) -> str:
    if problem.variable:
        return f"environment variable {problem.variable}: {problem.text}"
    other = f" (the other is on line {_line(problem.other, lines)})" if problem.other else ""
    return f"{path}, line {_line(problem.path, lines)}: {problem.text}{other}"


def _line(path: KeyPath, lines: Mapping[KeyPath, int]) -> int:
    """Line of a key, or of the nearest table around it where the key is missing."""
    while path and path not in lines:
        path = path[:-1]
    return lines.get(path, 1)


def from_validation(
    error: ValidationError, model: type[BaseModel], path: KeyPath = ()
) -> Iterator[Problem]:
    """Convert the errors of a model's validation to problems.

    Parameters
    ----------
    path
        Path of the model's table in the file.
    """
    overrides = {} if path else environment_overrides()
    reported = [] if path else [problem.variable for problem in unknown_variables(model)]
    for details in error.errors(include_url=False):
        where = (*path, *details["loc"])
        variable = _variable(where) if _is_set(where, overrides) else ""
        if variable and variable in reported:
            continue
        if details["type"] == "extra_forbidden":
            owner = _model_at(model, details["loc"][:-1])
            yield unknown_key(where, owner)._replace(variable=variable)
        else:
            text = _finding(where, details, in_json=bool(variable))
            yield Problem(ConfigReason.WRONG_VALUE, where, text, variable)


def _finding(path: KeyPath, details: ErrorDetails, *, in_json: bool) -> str:
    if details["type"] == "missing":
        return f"'{_dotted(path)}' is missing"
    said = _SUBJECT.sub("", details["msg"], count=1)
    expected = _EXPECTED.get(details["type"], said)
    if in_json and details["type"] == "tuple_type":
        expected = 'should be a list in JSON, such as ["one", "two"]'
    separator = " " if expected.startswith("should ") else ": "
    return f"'{_dotted(path)}'{separator}{expected}{_but_is(details['input'])}"


def _but_is(value: object) -> str:
    if isinstance(value, bool):
        return f", but is {str(value).lower()}"
    if not isinstance(value, str | int | float):
        return ""
    try:
        shown = repr(value)
    except ValueError:  # an integer of more digits than Python writes
        shown = hex(cast("int", value))
    cut = f"{shown[:_LONGEST_SHOWN]}…" if len(shown) > _LONGEST_SHOWN else shown
    return f", but is {cut}"


def unknown_key(path: KeyPath, model: type[BaseModel] | None) -> Problem:
    """Describe a key that the model does not have; ``None`` where no model is known."""
    known = _keys(model) if model else []
    hint = did_you_mean(str(path[-1]), known)
    listed = f"; known keys: {', '.join(known)}" if known else ""
    return Problem(ConfigReason.UNKNOWN_KEY, path, f"unknown key '{_dotted(path)}'{hint}{listed}")


def wrong_choice(path: KeyPath, key: str, value: object, known: Iterable[str]) -> Problem:
    """Describe a name that is missing (``None``) or unknown."""
    names = sorted(known)
    listed = f"should be one of {', '.join(names)}" if names else "has no known value"
    text = f"'{key}' is missing; it {listed}"
    if value is not None:
        hint = did_you_mean(value, names) if isinstance(value, str) else ""
        text = f"'{key}' {listed}{_but_is(value)}{hint}"
    return Problem(ConfigReason.WRONG_VALUE, path, text)


def unknown_variables(model: type[BaseModel]) -> Iterator[Problem]:
    """Find environment variables that look like overrides, but change nothing."""
    sections = {
        name.upper(): field.annotation
        for name, field in model.model_fields.items()
        if isinstance(field.annotation, type) and issubclass(field.annotation, BaseModel)
    }
    known = [OVERRIDE_PREFIX + section for section in sections]
    for section, annotation in sections.items():
        prefix = f"{OVERRIDE_PREFIX}{section}{OVERRIDE_DELIMITER}"
        known += [prefix + key.upper() for key in _keys(annotation)]
    beginnings = tuple(f"{OVERRIDE_PREFIX}{section}_" for section in sections)
    for variable in os.environ:
        name = variable.upper()
        is_override = name.startswith(OVERRIDE_PREFIX) and OVERRIDE_DELIMITER in name
        if (is_override or name.startswith(beginnings)) and name not in known:
            text = f"no setting has this name{did_you_mean(name, known)}"
            yield Problem(ConfigReason.UNKNOWN_KEY, (), text, variable)


def _is_set(path: KeyPath, overrides: Mapping[str, object]) -> bool:
    """Whether the overrides set a key or a table around it."""
    node: object = overrides
    for part in path:
        if not isinstance(node, dict):
            return True
        if part not in node:
            return False
        node = cast("dict[str | int, object]", node)[part]
    return True


def _variable(path: KeyPath) -> str:
    """Return the environment variable that sets a key, or the closest table around it."""
    keys = [str(part).upper() for part in path if isinstance(part, str)]
    name = OVERRIDE_PREFIX + OVERRIDE_DELIMITER.join(keys)
    related = [
        variable
        for variable in os.environ
        if f"{name}{OVERRIDE_DELIMITER}".startswith(f"{variable.upper()}{OVERRIDE_DELIMITER}")
        or variable.upper().startswith(f"{name}{OVERRIDE_DELIMITER}")
    ]
    return max(related, key=len)


def _model_at(model: type[BaseModel], path: KeyPath) -> type[BaseModel] | None:
    for part in path:
        field = model.model_fields.get(str(part))
        inner = field.annotation if field else None
        if not (isinstance(inner, type) and issubclass(inner, BaseModel)):
            return None
        model = inner
    return model


def _keys(model: type[BaseModel] | None) -> list[str]:
    fields = model.model_fields if model else {}
    return [field.alias or name for name, field in fields.items()]


def _dotted(path: KeyPath) -> str:
    return ".".join(str(part) for part in path if isinstance(part, str))
