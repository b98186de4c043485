"""What the installer puts on a PC besides its files: names of keys and places."""

from __future__ import annotations

from pathlib import Path

from tests.rigs.windows.pc import NAME, WindowsPc
from tests.rigs.windows.registry import Registry, Value

RUN_KEY = r"HKCU\Software\Microsoft\Windows\CurrentVersion\Run"
OWN_KEY = r"HKLM\Software\biosensor-gateway"
APP_PATH_KEY = r"HKLM\Software\Microsoft\Windows\CurrentVersion\App Paths\biosensor-gateway.exe"
ENVIRONMENT_KEY = r"HKLM\SYSTEM\CurrentControlSet\Control\Session Manager\Environment"
DEFAULT_FOLDER = rf"C:\Program Files\{NAME}"
BIN_FOLDER = rf"{DEFAULT_FOLDER}\bin"


def search_path(registry: Registry) -> Value:
    """Return the PATH of all users."""
    path = registry.value(ENVIRONMENT_KEY, "Path")
    assert path is not None
    return path


def path_entries(registry: Registry) -> list[str]:
    """Return its folders."""
    return str(search_path(registry).data).split(";")


def start_menu(pc: WindowsPc) -> Path:
    """Where the entries of the program are in the Start menu of all users."""
    menu = pc.drive_c / "ProgramData" / "Microsoft" / "Windows" / "Start Menu"
    return menu / "Programs" / NAME
