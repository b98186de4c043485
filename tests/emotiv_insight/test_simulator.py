"""The virtual Cortex, as a plain JSON-RPC client finds it, and what can befall it."""

from __future__ import annotations

import itertools
import json
import ssl
from collections.abc import Iterator
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
from websockets.asyncio.client import connect

from biosensor_gateway.devices.emotiv_insight.simulator import (
    INSIGHT_1,
    INSIGHT_1_GYRO,
    INSIGHT_2,
    Circumstances,
    Leaf,
    Licence,
    Metrics,
    Model,
    Release,
    Timing,
    User,
)
from biosensor_gateway.simulation.world import World
from tests.emotiv_insight.steering import SteeredCortex
from tests.rigs.cortex_client import CortexClient, CortexError

# The virtual Cortex, as a plain JSON-RPC client finds it.

APP = (SteeredCortex.client_id, SteeredCortex.client_secret)
CREDENTIALS = dict(zip(("clientId", "clientSecret"), APP, strict=True))
ALL = ("eeg", "mot", "pow", "met", "dev", "eq")
_VECTORS = json.loads((Path(__file__).parent / "vectors/emotiv_cortex.json").read_text("utf-8"))
VECTORS = {vector["name"]: vector for vector in _VECTORS["vectors"]}


@pytest.fixture
def world() -> Iterator[World]:
    with World() as world:
        yield world


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


async def refusal(client: CortexClient, method: str, **params: Any) -> int:
    with pytest.raises(CortexError) as caught:
        await client.ask(method, **params)
    return caught.value.code


async def test_the_way_from_the_first_request_to_data(world: World) -> None:
    with SteeredCortex(world, timing=Timing(connect_s=1.0)) as cortex:
        headset = cortex.settings["headset"]
        async with CortexClient(cortex.settings) as client:
            assert (await client.ask("getCortexInfo"))["version"] == "4.8.32"
            (login,) = await client.ask("getUserLogin")
            assert login["currentOSUId"] == login["loggedInOSUId"]
            assert (await client.ask("hasAccessRight", **CREDENTIALS))["accessGranted"]
            token = await client.authorize(*APP)
            assert await client.ask("queryHeadsets") == []
            await client.ask("controlDevice", command="refresh")
            await client.until_warned(142)
            (found,) = await client.ask("queryHeadsets", id="INSIGHT-*")
            assert found["id"] == headset
            assert (found["status"], found["sensors"]) == ("discovered", [])
            assert (found["settings"]["eegRate"], found["settings"]["mode"]) == (0, "UNKNOWN")
            connecting = await client.send("controlDevice", command="connect", headset=headset)
            listed = await client.send("queryHeadsets")
            assert "error" not in await connecting
            assert (await listed)["result"][0]["status"] == "connecting"
            assert (await client.until_warned(104))["message"]["headsetId"] == headset
            (found,) = await client.ask("queryHeadsets")
            assert (found["status"], found["settings"]["memsRate"]) == ("connected", 64)
            own = {"cortexToken": token}
            session = await client.ask("createSession", **own, headset=headset, status="active")
            assert session["status"] == "activated"
            sync = {"headset": headset, "monotonicTime": 1.0, "systemTime": 2.0}
            assert (await client.ask("syncWithHeadsetClock", **sync))["headset"] == headset
            own["session"] = session["id"]
            subscribed = await client.ask("subscribe", **own, streams=[*ALL, "xyz"])
            assert [one["streamName"] for one in subscribed["success"]] == list(ALL)
            (failed,) = subscribed["failure"]
            assert (failed["streamName"], failed["code"]) == ("xyz", -32016)
            await client.until(lambda: all(client.data[stream] for stream in ALL))
            assert {m["sid"] for stream in ALL for m in client.data[stream]} == {session["id"]}
            ended = await client.ask("unsubscribe", **own, streams=["eeg", "xyz"])
            assert ended["success"] == [{"streamName": "eeg"}]
            assert [one["code"] for one in ended["failure"]] == [-32016]
            (own_session,) = await client.ask("querySessions", cortexToken=token)
            assert own_session["streams"] == sorted(set(ALL) - {"eeg"})
            closed = await client.ask("updateSession", **own, status="close")
            assert closed["status"] == "closed"
            assert await client.ask("querySessions", cortexToken=token) == []


async def test_replies_have_the_shape_of_the_vectors(world: World) -> None:
    with SteeredCortex(
        world,
        Circumstances(release=Release("3.8.1"), user=User(other_os_user=True)),
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


async def test_wrong_requests_are_told_by_their_codes(world: World) -> None:
    with SteeredCortex(world) as cortex:
        async with CortexClient(cortex.settings) as client:
            wrong = {"clientId": APP[0], "clientSecret": "wrong"}
            assert await refusal(client, "authorize", **wrong) == -32021
            assert await refusal(client, "authorize") == -32602
            assert await refusal(client, "authorize", **CREDENTIALS, license="other") == -32002
            assert await refusal(client, "noMethod") == -32601
            assert await refusal(client, "createSession", cortexToken="x") == -32014
            token = await client.authorize(*APP)
            own = {"cortexToken": token}
            assert await refusal(client, "createSession", **own, status="open") == -32001
            assert await refusal(client, "createSession", **own, status="new") == -32602
            assert await refusal(client, "subscribe", **own, session="x", streams=[]) == -32007
            for text in ("{", "[1,2]", '{"jsonrpc":"2.0","id":7}'):
                await client.socket.send(text)
            await client.until(lambda: len(client.replies) == 3)
            assert [(r["id"], r["error"]["code"]) for r in client.replies] == [
                (None, -32700), (None, -32600), (7, -32600)
            ]  # fmt: skip


async def test_any_error_of_the_vectors_can_be_answered(world: World) -> None:
    errors = [v["message"]["error"] for v in VECTORS.values() if v["category"] == "error"]
    with SteeredCortex(world) as cortex:
        cortex.answer_with_error("getUserLogin", *(error["code"] for error in errors))
        async with CortexClient(cortex.settings) as client:
            for error in errors:
                reply = await (await client.send("getUserLogin"))
                assert reply.keys() == {"jsonrpc", "id", "error"}
                assert shape(reply["error"]) == shape(error)
                assert reply["error"]["code"] == error["code"]
            assert await client.ask("getUserLogin")


@pytest.mark.parametrize(
    ("licence", "active", "has_eeg"),
    [
        (Licence.NONE, -32006, False),
        (Licence.METRICS, None, False),
        (Licence.EEG, None, True),
        (Licence.EEG | Licence.METRICS, None, True),
    ],
)
async def test_a_licence_decides_about_eeg(
    world: World, licence: Licence, active: int | None, has_eeg: bool
) -> None:
    with SteeredCortex(world, Circumstances(user=User(licence=licence))) as cortex:
        async with CortexClient(cortex.settings) as client:
            token = await client.authorize(*APP)
            info = await client.ask("getLicenseInfo", cortexToken=token)
            assert ("eeg" in info["license"]["scopes"]) == has_eeg
            await client.connect_headset()
            status = "active"
            if active is not None:
                code = await refusal(client, "createSession", cortexToken=token, status="active")
                assert code == active
                status = "open"
            session = await client.ask("createSession", cortexToken=token, status=status)
            own = {"cortexToken": token, "session": session["id"]}
            result = await client.ask("subscribe", **own, streams=["eeg", "mot", "dev"])
            failed = [(one["streamName"], one["code"]) for one in result["failure"]]
            assert failed == ([] if has_eeg else [("eeg", -32016)])
            await client.until_data("mot", 3)
            cortex.license(Licence.EEG)
            await client.ask("updateSession", **own, status="active")
            await client.ask("subscribe", **own, streams=["eeg"])
            await client.until_data("eeg", 3)


@pytest.mark.parametrize("leaf", [Leaf.EXPIRED, Leaf.WRONG_NAME, Leaf.UNTRUSTED])
async def test_a_wrong_certificate_is_not_trusted(world: World, leaf: Leaf) -> None:
    with SteeredCortex(world, Circumstances(leaf=leaf)) as cortex:
        with pytest.raises(ssl.SSLCertVerificationError):
            async with CortexClient(cortex.settings):
                pass
        assert cortex.client_count == 0


async def test_the_authority_of_another_cortex_is_not_trusted(world: World) -> None:
    with SteeredCortex(world) as cortex, SteeredCortex(world) as other:
        settings = {**cortex.settings, "ca_file": other.settings["ca_file"]}
        with pytest.raises(ssl.SSLCertVerificationError):
            async with CortexClient(settings):
                pass


@pytest.mark.parametrize("lacks", [False, True])
async def test_strict_clients_want_the_key_usage_of_the_authority(
    world: World, lacks: bool
) -> None:
    with SteeredCortex(world, Circumstances(ca_without_key_usage=lacks)) as cortex:
        async with CortexClient(cortex.settings) as client:
            assert await client.ask("getUserLogin")
        strict = ssl.create_default_context(cafile=cortex.settings["ca_file"])
        strict.verify_flags |= ssl.VERIFY_X509_STRICT
        attempt = connect(cortex.settings["url"], ssl=strict, proxy=None)
        if lacks:
            with pytest.raises(ssl.SSLCertVerificationError, match="key usage"):
                await attempt
        else:
            await (await attempt).close()


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
