"""What the page's server keeps between requests."""

from __future__ import annotations

import json
import time
import traceback
from pathlib import Path

import pytest
from fastapi import Request
from fastapi.exceptions import RequestValidationError

from biosensor_common.errors import ConfigError
from biosensor_gateway.page.auth import ViewKeys
from biosensor_gateway.page.models import AgentState
from biosensor_gateway.page.routes.api import misformed
from biosensor_gateway.page.session import STARTING_S, Session


def test_settings_that_cannot_be_read_do_not_fill_the_memory(tmp_path: Path) -> None:
    # They are asked for with each status, twice a second for each window.
    path = tmp_path / "settings.toml"
    path.write_text("nonsense")
    session = Session(tmp_path, path)

    def frames() -> int:
        with pytest.raises(ConfigError) as caught:
            session.loaded()
        return len(traceback.extract_tb(caught.value.__traceback__))

    first = frames()
    for _ in range(10):
        session.status()
    assert frames() == first


@pytest.mark.parametrize(
    ("place", "said"),
    [(("body", "rest"), "rest: wrong word"), (("body",), "the request: wrong word")],
)
async def test_a_request_with_wrong_content_is_refused_with_its_place(
    place: tuple[str, ...], said: str
) -> None:
    wrong = RequestValidationError([{"loc": place, "msg": "wrong word", "type": "literal"}])
    answer = await misformed(Request({"type": "http"}), wrong)
    assert answer.status_code == 422
    assert json.loads(bytes(answer.body))["problem"] == said


def test_only_the_token_of_the_view_opens_it() -> None:
    keys = ViewKeys(8000)
    cookie = keys.cookie_for(keys.token)
    assert cookie is not None
    assert keys.fits(cookie)
    assert keys.cookie_for(keys.token + "x") is None
    assert not keys.fits(cookie + "x")


async def test_an_agent_that_was_started_is_waited_for_and_then_is_absent(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    session = Session(tmp_path, tmp_path / "settings.toml")
    assert session.agent is AgentState.ABSENT
    session.note_start()
    assert session.agent is AgentState.STARTING
    later_s = time.monotonic() + STARTING_S
    monkeypatch.setattr(time, "monotonic", lambda: later_s)
    assert session.agent is AgentState.ABSENT
