"""The shell completes commands, commands of groups, and options."""

from __future__ import annotations

import pytest

from biosensor_gateway.cli.app import app


@pytest.mark.parametrize(
    ("typed", "offered"),
    [
        ("biosensor-gateway rel", ["reload"]),
        ("biosensor-gateway record st", ["start", "stop", "status"]),
        ("biosensor-gateway record start --fo", ["--folder"]),
    ],
)
def test_what_is_begun_is_completed(
    typed: str,
    offered: list[str],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setenv("_BIOSENSOR_GATEWAY_COMPLETE", "complete_bash")
    monkeypatch.setenv("COMP_WORDS", typed)
    monkeypatch.setenv("COMP_CWORD", str(typed.count(" ")))
    with pytest.raises(SystemExit) as ended:
        app()(args=[], prog_name="biosensor-gateway")
    assert ended.value.code == 0
    assert capsys.readouterr().out.split() == offered
