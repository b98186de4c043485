"""The virtual Cortex, as a plain JSON-RPC client finds it, and what can befall it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, cast

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

# The virtual Cortex, as a plain JSON-RPC client finds it.

APP = (SteeredCortex.client_id, SteeredCortex.client_secret)
CREDENTIALS = dict(zip(("clientId", "clientSecret"), APP, strict=True))
_VECTORS = json.loads((Path(__file__).parent / "vectors/emotiv_cortex.json").read_text("utf-8"))
VECTORS = {vector["name"]: vector for vector in _VECTORS["vectors"]}


def shape(value: Any) -> Any:
    """Keys and types of a message, without its values."""
    match value:
        case dict():
            fields = cast("dict[str, Any]", value)
            return {key: shape(inner) for key, inner in fields.items()}
        case list():
            return [shape(inner) for inner in cast("list[Any]", value)]
        case bool() | str() | None:
            return type(value)
        case _:
            return float


async def test_replies_have_the_shape_of_the_vectors(world: World) -> None:
    with SteeredCortex(
        world,
        Circumstances(release=Release("3.8.1")),
        model=INSIGHT_2,
        seed=2,
    ) as cortex:
        async with CortexClient(cortex.settings) as client:
            replies = {
                "res_getCortexInfo_v4": await (await client.send("getCortexInfo")),
                "res_getUserLogin_other_os_user": await (await client.send("getUserLogin")),
                "res_authorize": await (await client.send("authorize", **CREDENTIALS)),
            }
            token = replies["res_authorize"]["result"]["cortexToken"]
            await client.connect_headset()
            created = await (await client.send("createSession", cortexToken=token, status="active"))
            replies["res_createSession_activated_v3"] = created
            for name, reply in replies.items():
                assert shape(reply) == shape(VECTORS[name]["message"])
            known = VECTORS["res_createSession_activated_v3"]["message"]["result"]
            assert created["result"]["headset"] == known["headset"]
            assert created["result"]["performanceMetrics"] == known["performanceMetrics"]


@pytest.mark.parametrize(
    ("vector", "reported"), [("warn_104_headset_connected", 104), ("warn_142_scan_finished", 142)]
)
async def test_warnings_have_the_shape_of_the_vectors(
    world: World, vector: str, reported: int
) -> None:
    with SteeredCortex(world) as cortex:
        async with CortexClient(cortex.settings) as client:
            await client.connect_headset()
            warning = await client.until_warned(reported)
            assert shape(warning) == shape(VECTORS[vector]["message"]["warning"])


# What the virtual headset measures: data against truth, columns, counters and times.

STREAMS = ("eeg", "mot", "pow", "met", "dev")
ELECTRODES = ["AF3", "T7", "Pz", "T8", "AF4"]


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
