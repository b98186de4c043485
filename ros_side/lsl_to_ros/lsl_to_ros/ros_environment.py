"""Sets the environment of ROS before it starts: Fast DDS, and a folder for log files.

Fast DDS is configured for lossy networks and for programs that crash: lost messages are resent
after 50 ms, and messages use UDP also on one machine, never shared memory. The node announces
itself twice a second, and is ready when the others answer. Why:
docs/decisions/node/fast-dds-profile.md.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Mapping, MutableMapping
from importlib.metadata import PackageNotFoundError, version
from importlib.resources import files
from pathlib import Path

# Fast DDS 2 reads the first variable, Fast DDS 3 the second; the middleware of ROS for Fast DDS 3
# also passes the first one's file on.
PROFILES = ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE")
_FIRST_WITH_3 = 9
"""Major version of rclpy in Kilted, the first distribution with Fast DDS 3. Jazzy has 7."""
IN_FOLDER = ("DEFAULT_FASTRTPS_PROFILES.xml", "DEFAULT_FASTDDS_PROFILES.xml")
TRANSPORTS = "FASTDDS_BUILTIN_TRANSPORTS"
RANGE, PEERS = "ROS_AUTOMATIC_DISCOVERY_RANGE", "ROS_STATIC_PEERS"
LOCALHOST_ONLY = "ROS_LOCALHOST_ONLY"
"""The range's deprecated predecessor, which has precedence if it is 1, and has no peers."""


def fast_dds_generation() -> int:
    """Return the major version of Fast DDS, 2 or 3; their profile files are incompatible."""
    try:
        major = int(version("rclpy").partition(".")[0])
    except PackageNotFoundError:
        major = _FIRST_WITH_3
    return 3 if major >= _FIRST_WITH_3 else 2


def configure_fast_dds(
    environment: MutableMapping[str, str], folder: Path, middleware: str, fast_dds: int
) -> bool:
    """Configure Fast DDS for this process, unless the user has profiles.

    Call it before ROS starts.

    Parameters
    ----------
    environment
        Variables that Fast DDS and ROS read.
    folder
        Working folder, where Fast DDS searches profiles if no variable names them.
    middleware
        ROS's name of the middleware; that of Fast DDS begins with ``rmw_fastrtps``.
    fast_dds
        2 or 3.

    Returns
    -------
    bool
        Whether anything was set.
    """
    has_own = any(environment.get(name) for name in PROFILES)
    if not middleware.startswith("rmw_fastrtps") or has_own or _has_profiles(folder):
        return False
    profiles = "profiles.xml"
    if not environment.get(TRANSPORTS):
        environment[TRANSPORTS] = "UDPv4"
        if _is_local(environment):
            # For LOCALHOST, ROS would set the transports itself, with shared memory. So the range
            # is set to the subnet, and the profiles allow this machine only, without multicast.
            environment[RANGE] = "SUBNET"
            profiles = "localhost.xml"
    file = files("lsl_to_ros").joinpath(f"fastdds{fast_dds}_{profiles}")
    environment[PROFILES[fast_dds - 2]] = str(file)
    return True


def _has_profiles(folder: Path) -> bool:
    return any((folder / name).is_file() for name in IN_FOLDER)


def _is_local(environment: MutableMapping[str, str]) -> bool:
    """Whether ROS is limited to this machine; afterwards only the range variable says so."""
    if environment.get(LOCALHOST_ONLY) == "1":
        for name in (LOCALHOST_ONLY, PEERS):
            environment.pop(name, None)
        return True
    return environment.get(RANGE) == "LOCALHOST"


_VARIABLE, _HOME_VARIABLE = "ROS_LOG_DIR", "ROS_HOME"


def ensure_log_folder(environment: MutableMapping[str, str]) -> str:
    """Set a temporary log folder if the usual one is not writable, without which rclpy fails.

    Returns
    -------
    str
        A sentence about it; empty if the usual folder is used.
    """
    usual = usual_folder(environment)
    try:
        usual.mkdir(parents=True, exist_ok=True)
        if os.access(usual, os.W_OK):
            return ""
    except OSError:
        pass
    environment[_VARIABLE] = instead = tempfile.mkdtemp(prefix="ros-log-")
    return f"{usual} cannot be written; ROS's log files are in {instead} ({_VARIABLE} changes that)"


def usual_folder(environment: Mapping[str, str]) -> Path:
    """Return the folder for rcl's log files."""
    if environment.get(_VARIABLE):
        return Path(environment[_VARIABLE]).expanduser()
    home = environment.get(_HOME_VARIABLE) or "~/.ros"
    return Path(home).expanduser() / "log"
