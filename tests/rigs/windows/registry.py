"""The registry of a virtual PC, read from the files that Wine keeps it in.

They are current once all programs of the PC have ended. Format: ``server/registry.c``
of Wine 8.0 ("WINE REGISTRY Version 2"); types of values: Microsoft's "Registry value types".
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Self

from tests.rigs.windows.pc import NAME, WindowsPc

_FILES = {"HKLM": "system.reg", "HKCU": "user.reg"}
_KINDS = {"": "REG_SZ", "str(2):": "REG_EXPAND_SZ", "str(7):": "REG_MULTI_SZ"}

_CONTINUED = re.compile(r"\\\n *")
_KEY = re.compile(r"^\[(?P<key>.*)\] \d+$")
_TEXT = re.compile(r'^(?P<kind>|str\(\d\):)"(?P<text>.*)"$')
_VALUE = re.compile(r'^(?:@|"(?P<name>(?:[^"\\]|\\.)*)")=(?P<data>.*)$')
_ESCAPED = re.compile(r"\\(?:x(?P<unit>[0-9a-f]{1,4})|(?P<octal>[0-7]{1,3})|(?P<itself>.))")


@dataclass(frozen=True, slots=True)
class Value:
    """One value."""

    kind: str  # Its type as Windows calls it; that of binary values as Wine writes it.
    data: str | int  # Its text or number; binary values as they are written.


Key = dict[str, Value]
"""Values by name, in lower case; the default value has the empty name."""


class Registry:
    """What is kept for all users (``HKLM``) and for the PC's user (``HKCU``) at one time.

    Parameters
    ----------
    keys
        By path; upper and lower case make no difference.
    """

    def __init__(self, keys: dict[str, Key]) -> None:
        self._keys = {path.lower(): values for path, values in keys.items()}

    @classmethod
    def of(cls, prefix: Path) -> Self:
        """Read the registry of a Wine prefix in which no program runs."""
        return cls(
            {
                f"{root}\\{path}": values
                for root, name in _FILES.items()
                for path, values in _keys((prefix / name).read_text(encoding="ascii"))
            }
        )

    def key(self, path: str) -> Key | None:
        """Return the values of a key, None if there is no such key."""
        return self._keys.get(path.lower())

    def value(self, path: str, name: str) -> Value | None:
        """Return one value, None if there is none of that name."""
        return (self.key(path) or {}).get(name.lower())

    def changes_since(self, before: Registry) -> dict[str, tuple[Value | None, Value | None]]:
        r"""Return what came, went or changed: ``key\name``, with the value before and now.

        A key that is empty differs from one that is absent: its entry is ``key\`` with
        no value on either side.
        """
        old, new = before._flat(), self._flat()
        return {
            f"{path}\\{name}": (old.get((path, name)), new.get((path, name)))
            for path, name in sorted({*old, *new})
            if ((path, name) in old) != ((path, name) in new) or old[path, name] != new[path, name]
        }

    def _flat(self) -> dict[tuple[str, str], Value | None]:
        values = {
            (path, name): each for path, key in self._keys.items() for name, each in key.items()
        }
        return {**{(path, ""): None for path in self._keys}, **values}


def _keys(text: str) -> Iterator[tuple[str, Key]]:
    values: Key = {}
    for line in _CONTINUED.sub("", text).splitlines():
        if key := _KEY.match(line):
            values = {}
            yield _unescaped(key["key"]), values
        elif value := _VALUE.match(line):
            values[_unescaped(value["name"] or "").lower()] = _value(value["data"])


def _value(written: str) -> Value:
    if text := _TEXT.match(written):
        return Value(_KINDS[text["kind"]], _unescaped(text["text"]))
    kind, _, digits = written.partition(":")
    return Value("REG_DWORD", int(digits, 16)) if kind == "dword" else Value(kind, digits)


def _unescaped(written: str) -> str:
    return _ESCAPED.sub(_character, written)


def _character(escaped: re.Match[str]) -> str:
    if escaped["unit"]:
        return chr(int(escaped["unit"], 16))
    return chr(int(escaped["octal"], 8)) if escaped["octal"] else escaped["itself"]


# What the installer puts on a PC besides its files: names of keys and places.

RUN_KEY = r"HKCU\Software\Microsoft\Windows\CurrentVersion\Run"
OWN_KEY = r"HKLM\Software\biosensor-gateway"
APP_PATH_KEY = r"HKLM\Software\Microsoft\Windows\CurrentVersion\App Paths\biosensor-gateway.exe"
ENVIRONMENT_KEY = r"HKLM\SYSTEM\CurrentControlSet\Control\Session Manager\Environment"
DEFAULT_FOLDER = rf"C:\Program Files\{NAME}"
BIN_FOLDER = rf"{DEFAULT_FOLDER}\bin"


def search_path(registry: Registry) -> Value:
    """Return the PATH of all users."""
    path = registry.value(ENVIRONMENT_KEY, "Path")
    assert path is not None
    return path


def path_entries(registry: Registry) -> list[str]:
    """Return its folders."""
    return str(search_path(registry).data).split(";")


def start_menu(pc: WindowsPc) -> Path:
    """Where the entries of the program are in the Start menu of all users."""
    menu = pc.drive_c / "ProgramData" / "Microsoft" / "Windows" / "Start Menu"
    return menu / "Programs" / NAME
