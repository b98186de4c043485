"""Two straps of a kind, with participants, with labels, with neither, in many orders of starting.

The real agents (one for both straps, or one each, as on two hosts) and the real node are
started and stopped one after the other. Whatever the order, all that is ever heard on a
topic is what one strap measured.
"""

from __future__ import annotations

import json
import signal
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from numpy.typing import NDArray
from std_msgs.msg import Float32

from tests.rigs.lab_client import LabProcess
from tests.rigs.polling import wait_until

pytestmark = pytest.mark.nightly

Values = NDArray[np.float32]

UNITS = {"A": "AAAA0001", "B": "BBBB0002"}
SENSOR = "biosensors/polar_h10"
BARE = f"/{SENSOR}"
FLOWING = 40
# Of one step: processes start, connect and find each other.
DEADLINE_S = 60.0
# So many samples of an ECG with noise are like no others.
CERTAIN = 12


class Scene(NamedTuple):
    """How the straps are told apart, where they are to be heard, and what happens.

    ``A`` and ``B`` start an agent for one strap, ``X`` one for both, ``N`` the node;
    the small letters stop them.
    """

    places: dict[str, dict[str, str]]
    topics: dict[str, str]
    steps: str

    @property
    def name(self) -> str:
        kind = next(iter(self.places["A"]), "neither")
        return f"{kind}-{self.steps}"


PARTICIPANTS = (
    {"A": {"participant": "p01"}, "B": {"participant": "p02"}},
    {"A": f"/p01/{SENSOR}", "B": f"/p02/{SENSOR}"},
)
LABELS = (
    {"A": {"label": "left"}, "B": {"label": "right"}},
    {"A": f"/{SENSOR}_left", "B": f"/{SENSOR}_right"},
)
NEITHER: tuple[dict[str, dict[str, str]], dict[str, str]] = (
    {"A": {}, "B": {}},
    {strap: f"/{SENSOR}_{unit}" for strap, unit in UNITS.items()},
)
SCENES = [
    Scene(*PARTICIPANTS, "XNxX"),
    Scene(*PARTICIPANTS, "NBAbB"),
    Scene(*LABELS, "ANBnN"),
    Scene(*NEITHER, "NXxX"),
    Scene(*NEITHER, "NABaA"),
    Scene(*NEITHER, "NBbAB"),
    Scene(*NEITHER, "BANbnN"),
]


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LabProcess]:
    devices = [
        {
            "key": strap,
            "sensor": "polar_h10",
            "options": {
                "address": f"A0:9E:1A:00:00:0{number}",
                "device_id": unit,
                "seed": number,
                "drift_ppm": 40.0 * number,
                "jitter_s": 0.02,
            },
        }
        for number, (strap, unit) in enumerate(UNITS.items(), 1)
    ]
    with LabProcess(devices, tmp_path_factory.mktemp("lab")) as running:
        yield running


def straps_of(program: str) -> str:
    return {"X": "AB", "N": ""}.get(program, program)


def part_of(received: Values, truth: Values) -> bool:
    """Whether all that was received are stretches of one strap's truth."""
    starts = {
        truth[index : index + CERTAIN].tobytes(): index for index in range(len(truth) - CERTAIN + 1)
    }
    position = 0
    while position < len(received):
        start = starts.get(received[position : position + CERTAIN].tobytes())
        if start is None:
            return False
        length = min(len(received) - position, len(truth) - start)
        same = received[position : position + length] == truth[start : start + length]
        position += length if same.all() else int(same.argmin())
    return True


class Stage:
    """What runs, where that should be heard, and what was heard."""

    def __init__(
        self, scene: Scene, lab: LabProcess, programs: Any, listener: Any, folder: Path
    ) -> None:
        self._scene, self._lab, self._programs, self._folder = scene, lab, programs, folder
        self._ros = listener.node
        self._running: dict[str, Any] = {}
        self._met: set[str] = set()
        self._open: set[str] = set()
        self._reports = listener.listen(DiagnosticArray, "/diagnostics")
        self.heard = {
            base: listener.listen(Float32, f"{base}/ecg") for base in (BARE, *scene.topics.values())
        }

    @property
    def has_node(self) -> bool:
        return "N" in self._running

    @property
    def straps(self) -> set[str]:
        """Those whose agent runs."""
        return {strap for program in self._running for strap in straps_of(program)}

    @property
    def collides(self) -> bool:
        """Whether the node has met two straps that nothing but the unit tells apart."""
        return not any(self._scene.places.values()) and len(self._met) == 2

    def take(self, step: str) -> None:
        """Start or stop a program."""
        if step.islower():
            process = self._running.pop(step.upper())
            process.send_signal(signal.SIGINT)
            assert process.wait(30) == 0
        elif step == "N":
            self._running[step] = self._programs.node()
            self._met = set()
            self._open = set()
        else:
            self._running[step] = self._agent(step)
        self._met |= self.straps
        # Topics stay for what may come back; only a name that two could claim is given up.
        self._open |= self.expected()
        if self.collides:
            self._open.discard(BARE)

    def expected(self) -> set[str]:
        """Where something must be heard now."""
        if not self.has_node:
            return set()
        named = any(self._scene.places.values()) or self.collides
        return {self._scene.topics[strap] if named else BARE for strap in self.straps}

    def is_as_expected(self, before: dict[str, int]) -> bool:
        """Whether samples flow where they should, and the node has no other topics."""
        flows = all(len(self.heard[base]) > before[base] + FLOWING for base in self.expected())
        return flows and (not self.has_node or self._offered() == self._open)

    def says_so(self) -> bool:
        """Whether the node's newest report calls exactly a collision an error."""
        levels = {
            status.name.removeprefix("lsl_to_ros: ").rpartition("/")[0]: status
            for report in self._reports[-1:]
            for status in report.status
            if status.name.endswith("/ecg")
        }
        return levels.keys() == self.expected() and all(
            (status.level == DiagnosticStatus.ERROR and "label" in status.message) is self.collides
            for status in levels.values()
        )

    def _offered(self) -> set[str]:
        topics = [name for name, _ in self._ros.get_topic_names_and_types()]
        return {
            topic.rpartition("/")[0]
            for topic in topics
            if SENSOR in topic and self._ros.count_publishers(topic)
        }

    def _agent(self, step: str) -> Any:
        blocks: list[str] = []
        for strap in straps_of(step):
            device = {**self._lab.settings[strap], **self._scene.places[strap]}
            fields = {"sensor": "polar_h10", "unit": UNITS[strap], **device}
            lines = [f"{key} = {json.dumps(value)}" for key, value in fields.items()]
            blocks.append("\n".join(["[[device]]", *lines]))
        path = self._folder / f"{step}.toml"
        path.write_text("\n".join(blocks))
        return self._programs.start("biosensor_gateway.cli", "run", "--settings", str(path))


@pytest.mark.parametrize("scene", SCENES, ids=lambda scene: scene.name)
def test_no_strap_is_ever_heard_under_the_topic_of_the_other(
    scene: Scene,
    lab: LabProcess,
    programs: Any,
    listener: Any,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for variable, text in lab.environment.items():
        monkeypatch.setenv(variable, text)
    stage = Stage(scene, lab, programs, listener, tmp_path)
    lives = [0]
    for number, step in enumerate(scene.steps, 1):
        if step == "N":
            lives.append(len(stage.heard[BARE]))
        # Two hosts have two folders.
        monkeypatch.setenv("BIOSENSOR_GATEWAY_STATE", str(tmp_path / step))
        stage.take(step)
        before = {base: len(messages) for base, messages in stage.heard.items()}
        what = f"step {number} of {scene.steps}, {stage.expected()}"
        wait_until(partial(stage.is_as_expected, before), what, DEADLINE_S)
        if stage.expected():
            wait_until(stage.says_so, f"{what} in the diagnostics", DEADLINE_S)

    heard = {
        base: np.array([message.data for message in messages], np.float32)
        for base, messages in stage.heard.items()
    }
    truths = {strap: lab.truth(strap)["ecg"].values.ravel().astype(np.float32) for strap in UNITS}
    for strap, base in scene.topics.items():
        (other,) = UNITS.keys() - {strap}
        assert part_of(heard[base], truths[strap]), f"{base} has what {strap} never sent"
        assert not part_of(heard[base], truths[other]), "the straps cannot be told apart"
    assert not (len(heard[BARE]) and any(scene.places.values()))
    for one_life in np.split(heard[BARE], lives):
        # Until the second one came, the plain name was the first one's alone.
        owners = [strap for strap in UNITS if part_of(one_life, truths[strap])]
        assert len(owners) == 1 or not len(one_life)
