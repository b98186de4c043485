"""What Cortex refuses, what becomes of it, and that no secret shows in any of it."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import Callable, Generator
from typing import TYPE_CHECKING

import keyring
import pytest
from keyring.backends import null
from structlog.testing import capture_logs

from biosensor_common.errors import (
    ConfigError,
    CredentialError,
    CredentialReason,
    GatewayError,
    ProtocolError,
    ProtocolReason,
    TransportError,
    TransportReason,
)
from biosensor_gateway.agent.device_states import State
from biosensor_gateway.devices.emotiv_insight import driver
from biosensor_gateway.devices.emotiv_insight.driver import DRIVER, find
from biosensor_gateway.settings.models import LogSettings
from biosensor_gateway.system.logs import LOG_FILE_NAME, configure_logs
from tests.rigs.kept_logging import kept_logging
from tests.rigs.polling import eventually

if TYPE_CHECKING:
    from pathlib import Path

    from tests.emotiv_insight.conftest import Answers, InsightRun, Running, ScriptedCortex

MakeRun = Callable[..., "InsightRun"]

MISSING, REJECTED = CredentialReason.MISSING, CredentialReason.REJECTED
ABSENT, LOST = TransportReason.ABSENT, TransportReason.LOST
REFUSED = ProtocolReason.REFUSED


async def refusal(run: InsightRun) -> GatewayError:
    """Connect once, close, and return why it did not work."""
    made = DRIVER.make(run.settings, run.sink)()
    with pytest.raises(GatewayError) as raised:
        await made.connect()
    await made.close()
    return raised.value


@pytest.fixture
def run(cortex: ScriptedCortex, make_run: MakeRun, credentials: None, hasty: None) -> InsightRun:
    return make_run(**cortex.settings)


@pytest.mark.parametrize(
    ("method", "code", "reason", "words"),
    [
        ("getCortexInfo", -32122, REFUSED, "-32122"),
        ("getUserLogin", -32603, REFUSED, "-32603"),
        ("hasAccessRight", -32021, REJECTED, "check the client id and secret"),
        ("authorize", -32021, REJECTED, "check the client id and secret"),
        ("authorize", -32142, REJECTED, "check the client id and secret"),
        ("authorize", -32002, REJECTED, "a Cortex app that requires EEG"),
        ("authorize", -32033, MISSING, "log in"),
        ("authorize", -32102, MISSING, "approve"),
        ("authorize", -32003, REFUSED, "-32003"),
        ("queryHeadsets", -32001, ABSENT, "switch the headset on"),
        ("createSession", -32004, ABSENT, "switch the headset on"),
        ("createSession", -32007, LOST, "opened again"),
        ("subscribe", -32012, LOST, "opened again"),
        ("subscribe", -32601, REFUSED, "-32601"),
        ("subscribe", -32999, REFUSED, "-32999"),
    ],
)
async def test_a_refusal_is_classed_by_its_code(
    cortex: ScriptedCortex, answers: Answers, run: InsightRun, method: str, code: int,
    reason: object, words: str,
) -> None:  # fmt: skip
    cortex.on(method, answers.error(code))
    error = await refusal(run)
    assert error.reason is reason
    assert words in str(error)
    assert "\n" not in str(error)


async def test_a_token_that_is_refused_again_is_no_loop(
    cortex: ScriptedCortex, answers: Answers, run: InsightRun
) -> None:
    cortex.on("createSession", *[answers.error(-32014)] * 9)
    assert (await refusal(run)).reason is REJECTED
    assert (cortex.count("createSession"), cortex.count("authorize")) == (2, 2)


async def test_a_headset_that_is_nearly_ready_is_asked_again(
    cortex: ScriptedCortex, answers: Answers, running: Running
) -> None:
    cortex.on("createSession", *[answers.error(-32152)] * 3)
    async with running() as run:
        await eventually(run.is_streaming)
        assert run.states.count(State.CONNECTING) == 1
    cortex.on("createSession", *[answers.error(-32152)] * 4)
    async with running() as run:
        await eventually(lambda: "ready" in run.error)


async def test_another_user_of_the_computer_holds_cortex(
    cortex: ScriptedCortex, answers: Answers, run: InsightRun
) -> None:
    cortex.on("getUserLogin", answers.result([{"currentOSUId": "1", "loggedInOSUId": "2"}]))
    error = await refusal(run)
    assert isinstance(error, TransportError)
    assert error.reason is TransportReason.BUSY


async def test_an_answer_without_its_token_is_garbage(
    cortex: ScriptedCortex, answers: Answers, run: InsightRun
) -> None:
    cortex.on("authorize", answers.result({"cortexToken": 5}))
    assert (await refusal(run)).reason is ProtocolReason.GARBAGE


async def test_no_stream_at_all_is_a_refusal(cortex: ScriptedCortex, run: InsightRun) -> None:
    cortex.failures = dict.fromkeys(cortex.columns, -32016)
    error = await refusal(run)
    assert isinstance(error, ProtocolError)
    assert error.reason is REFUSED


async def test_two_headsets_are_not_chosen_from_by_chance(
    cortex: ScriptedCortex,
    make_run: MakeRun,
    run: InsightRun,
    running: Running,
) -> None:
    cortex.headsets = [cortex.headset(), {**cortex.headset(), "id": "INSIGHT2-99999999"}]
    error = await refusal(run)
    assert isinstance(error, ConfigError)
    assert "INSIGHT-12341234, INSIGHT2-99999999" in str(error)
    async with running(headset="INSIGHT-*") as streaming:
        await eventually(streaming.is_streaming)
    (session,) = [each.params for each in cortex.requests if each.method == "createSession"]
    assert session["headset"] == "INSIGHT-12341234"


@pytest.mark.parametrize("code", [100, 101, 102])
async def test_a_headset_that_cannot_be_connected_is_absent(
    cortex: ScriptedCortex, answers: Answers, run: InsightRun, code: int
) -> None:
    cortex.headsets = [cortex.headset("discovered")]

    async def fails(cortex: ScriptedCortex, *call: object) -> None:
        await answers.usual(cortex, *call)  # type: ignore[arg-type]
        await cortex.warn(code, {"headsetId": "INSIGHT-99999999", "behavior": "not ours"})
        await cortex.warn(code, {"headsetId": "INSIGHT-12341234", "behavior": "failed"})

    cortex.on("controlDevice", fails)
    error = await refusal(run)
    assert error.reason is ABSENT
    assert "cannot connect to INSIGHT-12341234" in str(error)
    (connect,) = [each.params for each in cortex.requests if each.method == "controlDevice"]
    assert connect == {"command": "connect", "headset": "INSIGHT-12341234"}


@pytest.mark.parametrize("code", [3, 11, 12, 16])
async def test_some_warnings_end_a_connection(
    cortex: ScriptedCortex, running: Running, code: int
) -> None:
    async with running() as run:
        await eventually(run.is_streaming)
        await cortex.warn(code)
        await eventually(lambda: run.states.count(State.STREAMING) == 2)


async def test_motion_that_never_comes_costs_eeg_one_connection_and_no_more(
    cortex: ScriptedCortex, running: Running
) -> None:
    async with running() as run:
        await eventually(run.is_streaming)
        start, number = time.time(), 0

        async def measure(count: int) -> None:
            nonlocal number
            for _ in range(count):
                await cortex.say(cortex.eeg(number, start))
                await asyncio.sleep(1 / 128)
                number += 1

        # Asked for with all others, then alone, and both again over a new connection.
        while cortex.count("subscribe") < 4:
            await measure(1)
        await measure(1)
        before = len(run.sink.rows["eeg"])
        await measure(300)
        await eventually(run.sink.has(before + 300, "eeg"))
        assert run.supervisor.connections == 2
    streams = [each.params["streams"] for each in cortex.requests if each.method == "subscribe"]
    assert [set(each) for each in (streams[1], streams[3])] == [{"mot", "pow"}] * 2


@pytest.mark.parametrize(("rate", "expected"), [(32, 32.0), (128, 128.0), (0, 64.0), (None, 64.0)])
async def test_the_headset_tells_the_rate_of_its_motion_sensor(
    cortex: ScriptedCortex, run: InsightRun, rate: int | None, expected: float
) -> None:
    cortex.headsets = [cortex.headset(memsRate=rate, eegRate=256)]
    made = DRIVER.make(run.settings, run.sink)()
    connected = await made.connect()
    await made.close()
    assert connected.rates == {"eeg": 256.0, "eeg_status": 256.0, "mot": expected, "gyro": 0.0}
    assert connected.info.serial_number == "INSIGHT-12341234"
    assert connected.info.firmware_version == "a11"


async def test_licence_and_debit_are_sent_as_they_are_set(
    cortex: ScriptedCortex, make_run: MakeRun, run: InsightRun
) -> None:
    special = make_run(**cortex.settings, license="licence-1", debit=0)
    made = DRIVER.make(special.settings, special.sink)()
    await made.connect()
    await made.close()
    (authorize,) = [each.params for each in cortex.requests if each.method == "authorize"]
    assert (authorize["license"], authorize["debit"]) == ("licence-1", 0)


@pytest.fixture
def empty_keyring() -> Generator[None]:
    before = keyring.get_keyring()
    keyring.set_keyring(null.Keyring())
    yield
    keyring.set_keyring(before)


@pytest.mark.usefixtures("empty_keyring")
async def test_without_credentials_nothing_is_asked(
    cortex: ScriptedCortex, run: InsightRun, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("EMOTIV_CLIENT_SECRET")
    for error in (await refusal(run), await failed_search(run)):
        assert isinstance(error, CredentialError)
        assert error.reason is MISSING
        assert "EMOTIV_CLIENT_SECRET" in str(error)
    assert "authorize" not in cortex.methods


async def failed_search(run: InsightRun) -> GatewayError:
    with pytest.raises(GatewayError) as raised:
        await find([run.settings])
    return raised.value


async def test_a_search_returns_the_headsets_of_cortex(
    cortex: ScriptedCortex, run: InsightRun, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(driver, "SEARCH_S", 0.3)
    cortex.headsets = [cortex.headset("discovered"), {"id": "EPOCX-1", "status": "discovered"}]
    with capture_logs() as logs:
        (first,) = await find([run.settings, run.settings])
    assert first.name == "blue"
    # It would be proposed for the settings, and then be refused.
    assert [entry.get("headset") for entry in logs if "not an Insight" in entry["event"]] == [
        "EPOCX-1"
    ]
    assert first.settings == {
        "unit": "INSIGHT-12341234", "headset": "INSIGHT-12341234", "url": cortex.url,
        "allow_remote": False, "ca_file": str(cortex.ca_file),
    }  # fmt: skip
    assert type(run.settings).model_validate({"sensor": "emotiv_insight", **first.settings})
    assert cortex.count("controlDevice") == 1


async def test_a_search_waits_for_nobody(
    cortex: ScriptedCortex, answers: Answers, run: InsightRun
) -> None:
    cortex.on("getUserLogin", answers.result([]))
    assert (await failed_search(run)).reason is MISSING
    cortex.on("authorize", answers.error(-32021))
    assert (await failed_search(run)).reason is REJECTED
    await cortex.stop()
    assert (await failed_search(run)).reason is ABSENT


@contextlib.contextmanager
def logging_into(folder: Path) -> Generator[None]:
    with kept_logging():
        configure_logs(LogSettings(), folder, verbose=True)
        yield


@pytest.mark.seam
async def test_no_secret_shows_anywhere(
    cortex: ScriptedCortex,
    answers: Answers,
    running: Running,
    planted: tuple[str, ...],
    tmp_path: Path,
    capfd: pytest.CaptureFixture[str],
) -> None:
    """Let Cortex repeat all that it was told, wherever it can."""
    quoting = answers.quoting
    cortex.on("hasAccessRight", quoting(-32603))
    cortex.on("authorize", quoting(-32021), answers.usual, quoting(-32142))
    cortex.on("subscribe", quoting(-32602))
    errors: set[str] = set()
    with logging_into(tmp_path):
        async with running() as run:
            await eventually(run.is_streaming)
            words = " ".join([*planted[:3], "end of quotation"])
            await cortex.warn(26, words)
            await cortex.warn(103, {"behavior": words})
            await eventually(lambda: bool(errors.add(run.error)) or "lost" in run.error)
            await eventually(run.is_streaming)
            cortex.on("createSession", quoting(-32014))
            await cortex.each_connection(lambda socket: socket.close(1011, "planted"))
            await eventually(lambda: bool(errors.add(run.error)) or "-32142" in run.error)
            await eventually(run.is_streaming)
    log = (tmp_path / LOG_FILE_NAME).read_text(encoding="utf-8")
    out, err = capfd.readouterr()
    shown = "".join([log, out, err, *errors])
    for told in ("hasAccessRight", "authorize", "subscribe", "end of quotation", "1011", "***"):
        assert told in shown
    assert not [text for text in planted if text in shown]


async def test_closing_ends_in_time_whatever_cortex_does(
    cortex: ScriptedCortex, run: InsightRun
) -> None:
    made = DRIVER.make(run.settings, run.sink)()
    await made.connect()
    await cortex.each_connection(lambda socket: socket.transport.pause_reading())
    # The supervisor leaves a driver to itself after two seconds.
    async with asyncio.timeout(10):
        await made.close()
    await cortex.each_connection(lambda socket: socket.transport.abort())
