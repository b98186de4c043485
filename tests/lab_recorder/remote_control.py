"""A peer with the remote control of LabRecorder, which really records.

Written from App-LabRecorder's source (``tcpinterface.cpp``, ``mainwindow.cpp``), with
what a client trips over:

* It answers ``OK`` without a line end to every line, when the line's work is done.
* One thread works off everything, as the window's does; while a message box is open,
  nothing is answered.
* ``update`` and ``start`` look for streams for a second; ``start`` selects all of them,
  whatever was selected before, and is ignored while a recording runs.
* ``filename`` knows only ``{option:value}``; a template is taken in lower case and leaves
  BIDS mode; a new task or modality sets the run to the first number that is free in the
  working folder (not in the study root), at most 1000.
* A file that is in the way is renamed.

Recording is done by the core of LabRecorder itself (``LabRecorderCLI``).
"""

from __future__ import annotations

import re
import socket
import threading
from contextlib import ExitStack
from pathlib import Path
from typing import Self

import pylsl

from tests.rigs.lab_recorder import LabRecorder

_OPTION = re.compile(r"\{(\w+?):([^}]*)\}")
_BIDS = "sub-%p/ses-%s/%m/sub-%p_ses-%s_task-%b_run-%r_%m.xdf"
_LOOKS_S = 1.0
_BACKLOG_S = 0.2


class LabRecorderPeer:
    """A context manager that listens on all interfaces, as the original does.

    Parameters
    ----------
    root
        Its study root at the start.
    port
        0 takes a free one.
    deaf
        Do not record when told to start, and answer as ever.
    """

    def __init__(self, root: Path, port: int = 0, *, deaf: bool = False) -> None:
        self._root, self._deaf = str(root), deaf
        self._template, self._bids = _BIDS, True
        self._fields = {"participant": "P001", "session": "S001", "acquisition": ""}
        self._task, self._modality, self._run = "Default", "eeg", 1
        self._recorder: ExitStack | None = None
        self._closing = threading.Event()
        self.box = ""
        """Text of the message box that waits for a click."""
        self.lines: list[str] = []
        self.files: list[Path] = []
        self._server = socket.create_server(("", port))
        self.port: int = self._server.getsockname()[1]
        self._thread = threading.Thread(target=self._serve, daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._closing.set()
        self._thread.join()
        self._server.close()
        self._stop()

    def click_start(self) -> None:
        """Start by the button of the window."""
        self._start()

    def _serve(self) -> None:
        self._server.settimeout(_BACKLOG_S)
        while not self._closing.is_set():
            try:
                client, _ = self._server.accept()
            except TimeoutError:
                continue
            with client:
                self._converse(client)

    def _converse(self, client: socket.socket) -> None:
        client.settimeout(_BACKLOG_S)
        waiting = b""
        while not self._closing.is_set():
            try:
                received = client.recv(4096)
            except TimeoutError:
                continue
            except OSError:
                return
            if not received:
                return
            *lines, waiting = (waiting + received).split(b"\n")
            for line in lines:
                self._handle(line.decode().strip())
                if self.box:
                    self._closing.wait()
                    return
                client.sendall(b"OK")

    def _handle(self, line: str) -> None:
        self.lines.append(line)
        if line == "start":
            self._start()
        elif line == "stop":
            self._stop()
        elif line == "update":
            self._refresh()
        elif "filename" in line:
            for option, value in _OPTION.findall(line):
                self._set(option.lower(), value)

    def _refresh(self) -> list[pylsl.StreamInfo]:
        return pylsl.resolve_streams(_LOOKS_S)

    def _set(self, option: str, value: str) -> None:
        if option == "root":
            self._root = value
        elif option == "template":
            self._bids, self._template = False, value.lower()
        elif option == "run":
            self._run = max(1, min(1000, int(value)))
        elif option == "task":
            self._task = value
            self._first_free_run()
        elif option == "modality":
            self._modality = value.lower()
            self._first_free_run()
        elif option in self._fields:
            self._fields[option] = value

    def _first_free_run(self) -> None:
        if self._counter in self._template:
            self._run = 1
            while Path(self._name).exists() and self._run < 1000:
                self._run += 1

    @property
    def _counter(self) -> str:
        return "%r" if self._bids else "%n"

    @property
    def _name(self) -> str:
        filled = self._template.replace("%b", self._task)
        for sign, option in (("%p", "participant"), ("%s", "session"), ("%a", "acquisition")):
            filled = filled.replace(sign, self._fields[option])
        filled = filled.replace("%m", self._modality)
        return filled.replace(self._counter, f"{self._run:03}").strip()

    def _start(self) -> None:
        if self._recorder is not None:
            return
        streams = self._refresh()
        if not self._root.strip():
            self.box = "Can not record without a Study Root folder."
            return
        path = Path(self._root) / self._name
        if path.is_dir():
            self.box = "Recording path already exists and is a directory"
            return
        if path.exists():
            number = 1
            while (old := path.with_name(f"{path.stem}_old{number}{path.suffix}")).exists():
                number += 1
            path.rename(old)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
        except OSError:
            self.box = f"Can not create the directory {path.parent}. Please check your permissions."
            return
        if self._deaf or not streams:
            return
        self._recorder = ExitStack()
        self._recorder.enter_context(LabRecorder(path, at_least=len(streams)))
        self.files.append(path)

    def _stop(self) -> None:
        if self._recorder is not None:
            self._recorder.close()
            self._recorder = None
