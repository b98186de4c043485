"""The program of the Start menu: opens the page in a separate window, without a console.

It starts the console program without a console, and waits for it. So a person gets a message even
if that program's interpreter crashes. This module imports little, because everything that it
imports is installed twice.
"""

from __future__ import annotations

import subprocess
import sys
import threading
from collections import deque
from collections.abc import Iterable

from biosensor_gateway.settings.places import state_folder
from biosensor_gateway.system.child import own_command

TITLE = "Biosensor Gateway"
PAGE = ("page", "--window", "--end-after", "2")

_LAST_LINES = 50
_LAST_WORDS_S = 2.0
_OWN_SENTENCE = "biosensor-gateway: "
# STATUS_CONTROL_C_EXIT of ntstatus.h: the exit code of a console program at logoff.
_LOGGED_OFF = 0xC000013A

if sys.platform == "win32":
    import ctypes

    _FLAGS = subprocess.CREATE_NO_WINDOW
    # MB_ICONERROR and MB_SETFOREGROUND of winuser.h.
    _MESSAGE_BOX = 0x10 | 0x10000

    def _tell(sentence: str) -> None:
        ctypes.windll.user32.MessageBoxW(None, sentence, TITLE, _MESSAGE_BOX)

else:
    _FLAGS = 0

    def _tell(sentence: str) -> None:
        sys.stderr.write(f"{TITLE}: {sentence}\n")


def main() -> int:
    """Open the page, wait until its program has ended, and return its exit code."""
    try:
        process = subprocess.Popen(
            own_command(PAGE),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
            errors="replace",
            creationflags=_FLAGS,
        )
    except OSError as error:
        _tell(f"The page cannot be started: {error.strerror or error}. Install the program again.")
        return 1
    said: deque[str] = deque(maxlen=_LAST_LINES)
    assert process.stderr is not None
    # On a thread: a browser that the page has started may hold the pipe open after the page's end.
    reader = threading.Thread(target=said.extend, args=(process.stderr,), daemon=True)
    reader.start()
    code = process.wait()
    if code not in {0, _LOGGED_OFF}:
        reader.join(_LAST_WORDS_S)
        _tell(_sentence(code, list(said)))
    return code


def _sentence(code: int, said: Iterable[str]) -> str:
    """Return why the page has ended: its last sentence of ours, or else its last line."""
    lines = [line.strip() for line in said if line.strip()]
    own = [line.removeprefix(_OWN_SENTENCE) for line in lines if line.startswith(_OWN_SENTENCE)]
    why = (own or lines or [f"exit code {code}"])[-1]
    return (
        f"The page has ended: {why}\n\nRunning streams and recordings continue. What the "
        f"page noted is in {state_folder() / 'page'}."
    )


if __name__ == "__main__":
    sys.exit(main())
