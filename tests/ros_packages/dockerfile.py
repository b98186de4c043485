"""The instructions of a Dockerfile."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import NamedTuple

_FLAG = re.compile(r"--(?P<name>[a-z]+)=(?P<value>\S+)\s*")


class Instruction(NamedTuple):
    """One instruction: ``COPY --from=build /a /b``."""

    name: str
    flags: dict[str, str]
    value: str

    @property
    def words(self) -> list[str]:
        return self.value.split()

    @property
    def exec_form(self) -> list[str]:
        """Words of a JSON array; anything else would be run by a shell."""
        words: list[str] = json.loads(self.value)
        return words


def read(path: Path) -> list[Instruction]:
    """Read a file that has neither heredocs nor an escape directive."""
    text = path.read_text()
    assert "<<" not in text
    assert "escape=" not in text
    lines = [line for line in text.splitlines() if line.strip() and not line.startswith("#")]
    logical = re.sub(r"\\\n\s*", "", "\n".join(lines)).splitlines()
    return [_instruction(line) for line in logical]


def stages(instructions: list[Instruction]) -> list[list[Instruction]]:
    """Split at each FROM."""
    parts: list[list[Instruction]] = []
    for instruction in instructions:
        if instruction.name == "FROM":
            parts.append([])
        parts[-1].append(instruction)
    return parts


def _instruction(line: str) -> Instruction:
    name, _, value = line.partition(" ")
    assert re.fullmatch(r"[A-Z]+", name), f"no instruction: {line}"
    flags: dict[str, str] = {}
    while match := _FLAG.match(value):
        flags[match["name"]] = match["value"]
        value = value[match.end() :]
    return Instruction(name, flags, value)
