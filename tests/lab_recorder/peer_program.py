"""The peer as a program: ``python -m tests.lab_recorder.peer_program ROOT PORT``."""

from __future__ import annotations

import signal
import sys
from pathlib import Path

from tests.lab_recorder.remote_control import LabRecorderPeer


def main() -> None:
    root, port = sys.argv[1:]
    # Waited for, so that no handler can come between two instructions.
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    with LabRecorderPeer(Path(root), int(port)):
        signal.sigwait({signal.SIGINT})


if __name__ == "__main__":
    main()
