"""What the virtual headset measures: data against truth, columns, counters and times."""

from __future__ import annotations

import itertools
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from biosensor_gateway.devices.emotiv_insight.simulator import (
    INSIGHT_1,
    INSIGHT_1_GYRO,
    INSIGHT_2,
    Circumstances,
    Metrics,
    Model,
    Release,
)
from biosensor_gateway.simulation.world import World
from tests.emotiv_insight.steering import SteeredCortex
from tests.rigs.cortex_client import CortexClient

APP = (SteeredCortex.client_id, SteeredCortex.client_secret)
STREAMS = ("eeg", "mot", "pow", "met", "dev")
ELECTRODES = ["AF3", "T7", "Pz", "T8", "AF4"]
_VECTORS = json.loads((Path(__file__).parent / "vectors/emotiv_cortex.json").read_text("utf-8"))
VECTORS = {vector["name"]: vector for vector in _VECTORS["vectors"]}


@pytest.fixture
def world() -> Iterator[World]:
    with World() as world:
        yield world


class Recording:
    """Some seconds of a client's data, with the columns of the subscription."""

    def __init__(self, client: CortexClient, columns: dict[str, list[Any]]) -> None:
        self.client = client
        self.columns = columns


async def record(cortex: SteeredCortex, eeg_samples: int, *streams: str) -> Recording:
    """Stream until so many EEG samples and one of each other stream are there; stop."""
    async with CortexClient(cortex.settings) as client:
        token, session = await client.begin(*APP)
        own = {"cortexToken": token, "session": session}
        subscribed = await client.ask("subscribe", **own, streams=list(streams))
        await client.until_data("eeg", eeg_samples)
        await client.until(lambda: all(client.data[stream] for stream in streams))
        await client.ask("unsubscribe", **own, streams=list(streams))
    return Recording(client, {one["streamName"]: one["cols"] for one in subscribed["success"]})


async def test_eeg_lies_on_its_offset_in_steps_of_the_converter(world: World) -> None:
    with SteeredCortex(world, model=INSIGHT_2) as cortex:
        await record(cortex, 128, "eeg")
        eeg = cortex.truth.samples("eeg").values
    assert 4000 < eeg.min() < eeg.max() < 4400
    assert (eeg.std(axis=0) > 3).all()
    steps = eeg / (5 / 39)
    assert np.abs(steps - np.rint(steps)).max() < 0.005


@pytest.mark.parametrize(("model", "rate"), [(INSIGHT_1, 64), (INSIGHT_1_GYRO, 128)])
async def test_counters_begin_again_each_second_and_times_are_even(
    world: World, model: Model, rate: int
) -> None:
    with SteeredCortex(world, model=model) as cortex:
        recording = await record(cortex, 300, "eeg", "mot")
        for stream, modulus in (("eeg", 128), ("mot", rate)):
            counters = [row[0] for row in recording.client.rows(stream)]
            assert set(counters) <= set(range(modulus))
            assert {(b - a) % modulus for a, b in itertools.pairwise(counters)} == {1}
            times = recording.client.times(stream)
            assert times == [round(t, 4) for t in times]
            assert np.abs(np.diff(times) - 1 / modulus).max() < 1.1e-4


async def test_attitude_and_acceleration_agree(world: World) -> None:
    with SteeredCortex(world) as cortex:
        await record(cortex, 64, "eeg", "mot")
        w, x, y, z, *_ = columns = cortex.truth.samples("mot").values.T
    np.testing.assert_allclose(w**2 + x**2 + y**2 + z**2, 1, atol=1e-5)
    to_world_z = np.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x**2 + y**2)])
    assert np.abs((to_world_z * columns[4:7]).sum(axis=0) + 1).max() < 0.05


@pytest.mark.parametrize(
    ("version", "metrics", "eeg_last", "dev", "met"),
    [
        ("2.0.3", None, "MARKER_HARDWARE", ["Battery", "Signal", ELECTRODES],
         ["eng", "exc", "lex", "str", "rel", "int", "foc"]),
        ("2.7.0", None, "MARKERS", VECTORS["dev_insight_1"]["cols"],
         VECTORS["met_13col_foc"]["cols"]),
        ("3.6.5", None, "MARKERS", VECTORS["dev_insight_1"]["cols"],
         VECTORS["met_13col_attention_last"]["cols"]),
        ("4.8.32", None, "MARKERS", VECTORS["dev_insight_1"]["cols"],
         VECTORS["met_13col_attention_first"]["cols"]),
        ("4.8.32", Metrics.FOCUS, "MARKERS", VECTORS["dev_insight_1"]["cols"],
         VECTORS["met_13col_foc"]["cols"]),
    ],
)  # fmt: skip
async def test_columns_are_those_of_the_release(
    world: World, version: str, metrics: Metrics | None, eeg_last: str, dev: list[Any],
    met: list[str],
) -> None:  # fmt: skip
    with SteeredCortex(world, Circumstances(release=Release(version, metrics))) as cortex:
        recording = await record(cortex, 5, *STREAMS)
    assert recording.columns["eeg"][-1] == eeg_last
    assert recording.columns["dev"] == dev
    assert recording.columns["met"] == met
    assert recording.columns["pow"] == VECTORS["pow_insight_1"]["cols"]


@pytest.mark.parametrize(
    ("model", "vector"),
    [(INSIGHT_1, "mot_quaternion_1"), (INSIGHT_1_GYRO, "mot_gyro_old_insight")],
)
async def test_messages_are_built_like_the_vectors(world: World, model: Model, vector: str) -> None:
    with SteeredCortex(world, model=model) as cortex:
        recording = await record(cortex, 5, *STREAMS, "eq")
    vectors = {
        "eeg": "eeg_insight_1",
        "mot": vector,
        "pow": "pow_insight_1",
        "dev": "dev_insight_1",
        "met": "met_13col_attention_first",
        "eq": "eq_insight_1",
    }
    for stream, name in vectors.items():
        assert recording.columns[stream] == VECTORS[name]["cols"]
        message, known = recording.client.data[stream][0], VECTORS[name]["message"]
        assert message.keys() == known.keys()
        for value, example in zip(message[stream], known[stream], strict=True):
            assert isinstance(value, list) == isinstance(example, list)
            assert isinstance(value, bool) == isinstance(example, bool)
