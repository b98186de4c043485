"""What a target is, and how it says that the code under test broke its promise."""

from __future__ import annotations

import sys
import traceback
import warnings
from collections.abc import Callable, Generator, Mapping
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple, NoReturn, cast

import structlog

CORPUS = Path(__file__).parent / "corpus"
DICTIONARY = Path(__file__).parent / "tokens.dict"
RAISED = "raised: "
"""What begins the line that says why an input is a find."""
_TESTS = Path(__file__).parents[1]
_OWN = "fuzz_"
SENSORS = {path.stem.removeprefix(_OWN): path for path in sorted(_TESTS.glob(f"*/{_OWN}*.py"))}
"""Targets of sensors: modules ``fuzz_NAME`` in the folders of their tests, and ``corpus/NAME``."""
NAMES = tuple(
    sorted({path.stem for path in Path(__file__).parent.glob("targets/[a-z]*.py")} | SENSORS.keys())
)
"""Every target: a module of `tests.fuzz.targets` and a folder of the corpus, or a sensor's."""


class BrokenContractError(AssertionError):
    """The code under test returned something that must not be."""


class Target(NamedTuple):
    """A reader under test."""

    name: str
    # Takes any bytes and returns. Whatever it raises is a find: it lets through no error but those
    # that the reader's documentation names.
    check: Callable[[bytes], None]


def ensure(holds: bool, promise: str, *facts: object) -> None:
    """Raise `BrokenContractError` if a promise is broken, with the facts that show it."""
    if not holds:
        shown = "; ".join(repr(fact) for fact in facts)
        raise BrokenContractError(f"{promise}: {shown}" if shown else promise)


def load(name: str) -> Target:
    """Import a target: one of `NAMES`, or any module that has a function ``check``.

    Raises
    ------
    ImportError
        If there is no such module.
    """
    return Target(name, cast("Callable[[bytes], None]", module_of(name).check))


def module_of(name: str) -> ModuleType:
    """Import what `load` does, and return it."""
    if name in SENSORS:
        return import_module(f"tests.{SENSORS[name].parent.name}.{SENSORS[name].stem}")
    return import_module(name if "." in name else f"tests.fuzz.targets.{name}")


def corpus_of(name: str) -> Path:
    """Return where the inputs of a target are; of one that is named as a module, the last part."""
    if name in SENSORS:
        return SENSORS[name].parent / "corpus" / name
    return CORPUS / name.rpartition(".")[2]


def inputs(folder: Path) -> list[Path]:
    """Return the files of a corpus, in the order of their names; none if it is not there."""
    return sorted(path for path in folder.glob("*") if path.is_file())


def tokens() -> list[bytes]:
    """Return the words of the dictionary."""
    lines = DICTIONARY.read_text(encoding="ascii").splitlines()
    return [line[1:-1].encode() for line in lines if line.startswith('"')]


def telling(check: Callable[[bytes], None]) -> Callable[[bytes], None]:
    """Have a target say in one line what it raises, however its process then ends."""

    def told(data: bytes) -> None:
        try:
            check(data)
        except Exception as error:
            raised = "".join(traceback.format_exception_only(error)).splitlines()[0]
            sys.stderr.write(f"{RAISED}{raised}\n")
            sys.stderr.flush()
            raise

    return told


@contextmanager
def strictly() -> Generator[None]:
    """Make every warning an error and keep the logs silent: of odd inputs they say too much."""
    before = structlog.get_config()
    structlog.configure(processors=[_drop])
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            yield
    finally:
        structlog.configure(**before)


def _drop(logger: object, method: str, event: Mapping[str, Any]) -> NoReturn:
    raise structlog.DropEvent
