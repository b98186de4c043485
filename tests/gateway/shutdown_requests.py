"""Windows only: start a program and ask it to end in a way that no Unix signal stands for.

``python shutdown_requests.py REQUEST RECORD PROGRAM ARGUMENT...`` starts PROGRAM with RECORD as
its first argument, waits until RECORD says ``running``, makes the REQUEST and exits with
PROGRAM's exit code. Standard library only; requests are

``ctrl-break``, ``close``, ``logoff``, ``shutdown``
    The console's events, made as Windows makes them: by a thread that begins at kernel32's
    CtrlRoutine in the program itself. (Wine 8 has no other way for these four, and its
    console ends its programs without a word when its window is closed.)
``session-ends``, ``session-goes-on``
    The window messages of a logoff, and those of a logoff that another program has stopped.
    After the latter RECORD says ``goes on``, and then the session ends all the same.
"""

from __future__ import annotations

import ctypes
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

DEADLINE_S = 30.0
WINDOW_CLASS = "BiosensorGatewaySession"
WM_QUERYENDSESSION, WM_ENDSESSION = 0x0011, 0x0016
ENDSESSION_LOGOFF = 0x80000000
CONSOLE_EVENTS = {"ctrl-break": 1, "close": 2, "logoff": 5, "shutdown": 6}
PROCESS_ALL_ACCESS = 0x001FFFFF

Program = subprocess.Popen[bytes]

if sys.platform == "win32":
    _user32 = ctypes.WinDLL("user32", use_last_error=True)
    _kernel32 = ctypes.WinDLL("kernel32", use_last_error=True)
    _user32.FindWindowW.restype = ctypes.c_void_p
    _user32.SendMessageW.argtypes = [
        *(ctypes.c_void_p, ctypes.c_uint),
        *(ctypes.c_size_t, ctypes.c_ssize_t),
    ]
    _user32.SendMessageW.restype = ctypes.c_ssize_t
    _kernel32.OpenProcess.restype = ctypes.c_void_p
    _kernel32.CreateRemoteThread.argtypes = [
        *(ctypes.c_void_p, ctypes.c_void_p, ctypes.c_size_t, ctypes.c_void_p),
        *(ctypes.c_size_t, ctypes.c_ulong, ctypes.c_void_p),
    ]
    _kernel32.CreateRemoteThread.restype = ctypes.c_void_p

    def console_event(event: int) -> Callable[[Program, Path], None]:
        def send(program: Program, _record: Path) -> None:
            process = _succeeded(_kernel32.OpenProcess(PROCESS_ALL_ACCESS, False, program.pid))
            # A system DLL has the same address in every process.
            routine = ctypes.cast(_kernel32.CtrlRoutine, ctypes.c_void_p)
            _succeeded(_kernel32.CreateRemoteThread(process, None, 0, routine, event, 0, None))

        return send

    def session_ends(_program: Program, _record: Path) -> None:
        window = _succeeded(_user32.FindWindowW(WINDOW_CLASS, None))
        assert _user32.SendMessageW(window, WM_QUERYENDSESSION, 0, ENDSESSION_LOGOFF)
        _user32.SendMessageW(window, WM_ENDSESSION, 1, ENDSESSION_LOGOFF)

    def session_goes_on(program: Program, record: Path) -> None:
        window = _succeeded(_user32.FindWindowW(WINDOW_CLASS, None))
        assert _user32.SendMessageW(window, WM_QUERYENDSESSION, 0, ENDSESSION_LOGOFF)
        assert _user32.SendMessageW(window, WM_ENDSESSION, 0, ENDSESSION_LOGOFF) == 0
        time.sleep(1.0)
        with record.open("a", encoding="utf-8") as file:
            file.write("goes on\n")
        session_ends(program, record)

    def _succeeded(result: int | None) -> int:
        if not result:
            raise ctypes.WinError(ctypes.get_last_error())
        return result

    REQUESTS: dict[str, Callable[[Program, Path], None]] = {
        **{name: console_event(event) for name, event in CONSOLE_EVENTS.items()},
        "session-ends": session_ends,
        "session-goes-on": session_goes_on,
    }

    def main() -> int:
        request, record, program, *rest = sys.argv[1:]
        process = subprocess.Popen([sys.executable, program, record, *rest])
        try:
            _wait_until_it_runs(process, Path(record))
            REQUESTS[request](process, Path(record))
            return process.wait(DEADLINE_S)
        finally:
            process.kill()

    def _wait_until_it_runs(process: Program, record: Path) -> None:
        deadline = time.monotonic() + DEADLINE_S
        while not (record.exists() and "running" in record.read_text("utf-8")):
            assert time.monotonic() < deadline, "it does not run"
            assert process.poll() is None, "it has ended"
            time.sleep(0.05)

    if __name__ == "__main__":
        raise SystemExit(main())
