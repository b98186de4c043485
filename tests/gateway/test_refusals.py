"""What the system refuses is one sentence, not a traceback."""

from __future__ import annotations

import errno
from pathlib import Path

import pytest

from biosensor_gateway.agent.single_instance import is_held
from biosensor_gateway.cli import app
from biosensor_gateway.cli.app import EXIT_FAILED, refusal


@pytest.mark.parametrize(
    ("code", "words"),
    [
        (errno.EACCES, "/home/x/.local/state: "),
        (errno.EROFS, "let BIOSENSOR_GATEWAY_STATE name another folder"),
        (errno.ENOSPC, "/home/x/.local/state: "),
        (errno.EMFILE, "no more files can be opened: this computer lets a program open"),
    ],
)
def test_what_the_system_refuses_is_said_with_what_to_do(code: int, words: str) -> None:
    assert words in refusal(OSError(code, "refused", "/home/x/.local/state"))


def test_what_should_not_happen_keeps_its_traceback() -> None:
    assert refusal(OSError(errno.EBADF, "bad", "/home/x")) == ""
    # Nothing names what was refused.
    assert refusal(OSError(errno.EACCES, "denied")) == ""


def test_a_command_that_is_refused_a_file_ends_with_the_sentence(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def refuse() -> None:
        raise PermissionError(errno.EACCES, "Permission denied", "/home/x/settings.toml")

    monkeypatch.setattr(app, "app", lambda: refuse)
    with pytest.raises(SystemExit) as ended:
        app.main()
    assert ended.value.code == EXIT_FAILED
    assert capsys.readouterr().err.startswith(
        "biosensor-gateway: /home/x/settings.toml: Permission denied; have it allowed"
    )


def test_nobody_runs_with_a_folder_that_may_not_be_looked_into() -> None:
    # Not even root can ask for a name that long.
    assert not is_held(Path("/") / ("x" * 300))
