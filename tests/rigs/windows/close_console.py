"""Windows only: tell a program that its console is being closed.

``python close_console.py PROCESS`` does it as Windows does: by a thread in the program itself
that begins at kernel32's CtrlRoutine. (Wine 8 has no other way; its console ends its
programs without a word when its window is closed.) Standard library only.
"""

from __future__ import annotations

import ctypes
import sys

CTRL_CLOSE_EVENT = 2
PROCESS_ALL_ACCESS = 0x001FFFFF

if sys.platform == "win32":

    def main() -> None:
        kernel32 = ctypes.WinDLL("kernel32", use_last_error=True)
        kernel32.OpenProcess.restype = ctypes.c_void_p
        kernel32.CreateRemoteThread.restype = ctypes.c_void_p
        kernel32.CreateRemoteThread.argtypes = [
            *(ctypes.c_void_p, ctypes.c_void_p, ctypes.c_size_t, ctypes.c_void_p),
            *(ctypes.c_size_t, ctypes.c_ulong, ctypes.c_void_p),
        ]
        process = kernel32.OpenProcess(PROCESS_ALL_ACCESS, False, int(sys.argv[1]))
        # A system DLL has the same address in every process.
        routine = ctypes.cast(kernel32.CtrlRoutine, ctypes.c_void_p)
        if not process or not kernel32.CreateRemoteThread(
            process, None, 0, routine, CTRL_CLOSE_EVENT, 0, None
        ):
            raise ctypes.WinError(ctypes.get_last_error())

    if __name__ == "__main__":
        main()
