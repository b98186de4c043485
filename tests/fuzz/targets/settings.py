"""The settings file.

It is read, or refused with a ConfigError whose every line names the file; a line that is
named is there; every key of a valid TOML text has its line.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator
from typing import cast

from biosensor_common.errors import ConfigError
from biosensor_gateway.devices.registry import settings_models
from biosensor_gateway.settings.file import load_settings
from biosensor_gateway.settings.problems import KeyPath, key_lines
from tests.fuzz.contract import ensure
from tests.fuzz.scratch import written

_LINE = re.compile(r"settings\.toml, line (\d+): ")
_MODELS = settings_models()


def check(data: bytes) -> None:
    """Load the file; then find the lines of its keys, whatever they mean."""
    path = written("settings.toml", data)
    text = data.decode("utf-8-sig", "replace").replace("\r\n", "\n").replace("\r", "\n")
    last_line = text.count("\n") + 1
    try:
        load_settings(path, _MODELS)
    except ConfigError as error:
        for line in str(error).splitlines():
            ensure(str(path) in line or not _LINE.search(line), "it names no file", str(error))
        named = [int(number) for number in _LINE.findall(str(error))]
        ensure(all(1 <= number <= last_line for number in named), "no such line", named, error)
    _find_lines(text, last_line)


def _find_lines(text: str, last_line: int) -> None:
    try:
        root = tomllib.loads(text)
    except (ValueError, RecursionError):
        return
    found = key_lines(text)
    for path in _paths(root):
        ensure(path in found, "a key has no line", path)
    ensure(all(1 <= line <= last_line for line in found.values()), "no such line", found)


def _paths(root: object) -> Iterator[KeyPath]:
    waiting: list[tuple[KeyPath, object]] = [((), root)]
    while waiting:
        path, node = waiting.pop()
        if path:
            yield path
        if isinstance(node, dict):
            items = cast("dict[str, object]", node).items()
            waiting += [((*path, key), value) for key, value in items]
        elif isinstance(node, list):
            values = cast("list[object]", node)
            waiting += [((*path, index), value) for index, value in enumerate(values)]
