"""Every input of every corpus keeps the contract; so regressions stay found."""

from __future__ import annotations

import importlib
import json
from collections.abc import Sequence
from dataclasses import replace
from operator import attrgetter
from pathlib import Path
from typing import Any

import pytest

from biosensor_common.lsl_header import Channels
from biosensor_gateway.recording.xdf.container import Damage
from tests.fuzz.breaking import Fault, always, instead
from tests.fuzz.contract import CORPUS, NAMES, SENSORS, corpus_of, inputs, load, module_of, strictly

MAX_CORPUS_BYTES = 1_000_000


@pytest.mark.parametrize("name", NAMES)
def test_no_input_breaks_the_contract(name: str) -> None:
    target = load(name)
    broken: list[str] = []
    with strictly():
        for path in inputs(corpus_of(name)):
            try:
                target.check(path.read_bytes())
            except Exception as error:  # noqa: BLE001 - anything is a find
                broken.append(f"{path.name}: {type(error).__name__}: {error}")
    assert not broken, "\n".join(broken)


def test_every_target_has_a_corpus_and_no_corpus_is_left_over() -> None:
    tests = CORPUS.parents[1]
    own = {folder.name for folder in tests.glob("*/corpus/*") if folder.parent != CORPUS}
    assert own == set(SENSORS)
    assert {folder.name for folder in CORPUS.iterdir()} == set(NAMES) - own
    assert all(inputs(corpus_of(name)) for name in NAMES)


def test_the_corpora_are_small() -> None:
    sizes = [path.stat().st_size for name in NAMES for path in inputs(corpus_of(name))]
    assert sum(sizes) < MAX_CORPUS_BYTES


# Every target notices when the code that it guards is broken, with its corpus alone.

NO_CHANNELS = Channels((), (), ())


def ends_too_late(find_damage: Any) -> Any:
    def broken(*where: Any) -> Damage:
        damage: Damage = find_damage(*where)
        return replace(damage, end=damage.end + 1)

    return broken


def loses_the_last(batches: Any) -> Any:
    def broken(*of: Any) -> Any:
        return iter(list(batches(*of))[:-1])

    return broken


def any_share(value: float, limits: tuple[float, float]) -> float:
    return (value - limits[0]) / (limits[1] - limits[0])


def any_names(fields: Sequence[Any], message: Any) -> object:
    """The names of a message, also where two are alike."""
    for field in fields:
        if field.path == "name":
            return attrgetter("name"), list(message.name)
    return None


def any_text(text: str) -> str:
    return text


def any_path(scanner: object, path: object, line: int) -> object:
    return path


def any_status(folder: Path) -> object:
    return json.loads((folder / "status.json").read_text())


# Where, what, and how it is broken; a sensor's own targets say it themselves.
FAULTS: dict[str, Fault] = {
    "bags": ("biosensor_gateway.recording.xdf.chunks", "footer", always(b"")),
    "control_request": (
        "biosensor_gateway.agent.control_server.ControlServer",
        "_is_token",
        always(True),
    ),
    "counters": ("biosensor_common.ros.messages", "_finite", instead(float)),
    "features": ("biosensor_gateway.features.quality", "_scaled", instead(any_share)),
    "lsl_config": ("biosensor_gateway.cli.config.LslFile", "adapt", always(None)),
    "lsl_header": ("biosensor_common.lsl_header", "read_channels", always(NO_CHANNELS)),
    "naming": ("biosensor_common.naming", "_escape", instead(any_text)),
    "ros_to_lsl": ("biosensor_common.ros.layout", "_names_in", instead(any_names)),
    "settings": ("biosensor_gateway.settings.problems._Scanner", "_note", instead(any_path)),
    "status": ("tests.fuzz.targets.status", "read_status", instead(any_status)),
    "xdf": ("biosensor_gateway.recording.xdf.container", "_damage", ends_too_late),
    "xdf_export": ("biosensor_gateway.recording.export.csv.wide", "batches", loses_the_last),
}


def owner(path: str) -> Any:
    """Import a module, or a class of one."""
    try:
        return importlib.import_module(path)
    except ImportError:
        module, _, name = path.rpartition(".")
        return getattr(importlib.import_module(module), name)


@pytest.mark.parametrize("name", NAMES)
def test_a_broken_reader_is_found(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    target = load(name)
    path, attribute, breaking = module_of(name).FAULT if name in SENSORS else FAULTS[name]
    place = owner(path)
    monkeypatch.setattr(place, attribute, breaking(getattr(place, attribute)))
    with strictly(), pytest.raises(Exception):  # noqa: B017 - anything is a find
        for each in inputs(corpus_of(name)):
            target.check(each.read_bytes())
