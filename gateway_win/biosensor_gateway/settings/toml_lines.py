"""Finds the line of a TOML text on which a key stands; parsers give the values alone.

The text has been accepted by :mod:`tomllib`, so this scanner only has to tell
keys from values, not to find mistakes. Grammar: TOML 1.0.0, toml.io/en/v1.0.0.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator
from typing import NamedTuple

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
            # A quoted key has the escapes of a string; the parser knows them all.
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
            # Below an array of tables, a header means the newest element.
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
