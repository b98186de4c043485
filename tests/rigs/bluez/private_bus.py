"""A D-Bus daemon that only those who know its address can reach."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from pathlib import Path
from typing import Self

_CONFIGURATION = """\
<!DOCTYPE busconfig PUBLIC "-//freedesktop//DTD D-Bus Bus Configuration 1.0//EN"
 "http://www.freedesktop.org/standards/dbus/1.0/busconfig.dtd">
<busconfig>
  <listen>unix:path={socket}</listen>
  <auth>EXTERNAL</auth>
  <policy context="default">
    <allow send_destination="*" eavesdrop="true"/>
    <allow eavesdrop="true"/>
    <allow own="*"/>
  </policy>
</busconfig>
"""
# bleak asks the version of BlueZ of this program.
_BLUETOOTHCTL = "#!/bin/sh\necho 'bluetoothctl: 5.66'\n"
_STOP_S = 10.0


class PrivateBus:
    """The daemon, while the context lasts."""

    def __init__(self) -> None:
        self._folder = Path(tempfile.mkdtemp(prefix="bluez-"))
        socket = self._folder / "socket"
        self.address = f"unix:path={socket}"  # Where it listens.
        # What a process needs to take it for the system bus of a machine with BlueZ.
        self.environment = {
            "DBUS_SYSTEM_BUS_ADDRESS": self.address,
            "PATH": f"{self._folder}{os.pathsep}{os.environ['PATH']}",
        }
        configuration = self._folder / "bus.conf"
        configuration.write_text(_CONFIGURATION.format(socket=socket))
        program = self._folder / "bluetoothctl"
        program.write_text(_BLUETOOTHCTL)
        program.chmod(0o755)
        self._command = [
            "dbus-daemon",
            f"--config-file={configuration}",
            "--nofork",
            "--nopidfile",
            "--print-address",
        ]
        self._daemon: subprocess.Popen[bytes] | None = None

    def __enter__(self) -> Self:
        self._daemon = subprocess.Popen(
            self._command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
        )
        assert self._daemon.stdout
        # It prints its address when it listens.
        if not self._daemon.stdout.readline():
            self.kill()
            raise RuntimeError("dbus-daemon does not start")
        return self

    def __exit__(self, *_: object) -> None:
        self.kill()
        shutil.rmtree(self._folder, ignore_errors=True)

    def kill(self) -> None:
        """End the daemon; everybody on the bus loses the connection."""
        if self._daemon:
            daemon, self._daemon = self._daemon, None
            daemon.kill()
            daemon.wait(_STOP_S)
            assert daemon.stdout
            daemon.stdout.close()
