"""Sets Fast DDS up for lossy networks and for programs that crash.

Lost messages are sent again after 50 ms (decision 23), and messages go over UDP on one
machine, too, never through shared memory (decision 28). The node announces itself twice a
second (decision 29), and is ready when the others answer (decision 47).
"""

from __future__ import annotations

from collections.abc import MutableMapping
from importlib.resources import files
from pathlib import Path

# Fast DDS 2 reads the first, Fast DDS 3 the second.
PROFILES = ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE")
# Fast DDS 3 refuses a file with an element that only Fast DDS 2 knows.
FAMILIES = ("fastdds2", "fastdds")
IN_FOLDER = ("DEFAULT_FASTRTPS_PROFILES.xml", "DEFAULT_FASTDDS_PROFILES.xml")
TRANSPORTS = "FASTDDS_BUILTIN_TRANSPORTS"
RANGE, PEERS = "ROS_AUTOMATIC_DISCOVERY_RANGE", "ROS_STATIC_PEERS"
LOCALHOST_ONLY = "ROS_LOCALHOST_ONLY"
"""The predecessor of the range, which comes first where it is 1, and knows no peers."""


def configure(environment: MutableMapping[str, str], folder: Path, middleware: str) -> bool:
    """Set Fast DDS for this process, unless the user has profiles.

    It has to be called before ROS starts.

    Parameters
    ----------
    environment
        What Fast DDS and ROS read.
    folder
        The working folder, where Fast DDS looks for profiles that no variable names.
    middleware
        ROS's name of it; only that of Fast DDS begins with ``rmw_fastrtps``.

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
            # There ROS sets the transports itself, with shared memory. So it is told of a
            # subnet, and the profiles say what it would have: no multicast, and this machine.
            environment[RANGE] = "SUBNET"
            profiles = "localhost.xml"
    for name, family in zip(PROFILES, FAMILIES, strict=True):
        environment[name] = str(files("lsl_to_ros").joinpath(f"{family}_{profiles}"))
    return True


def _has_profiles(folder: Path) -> bool:
    return any((folder / name).is_file() for name in IN_FOLDER)


def _is_local(environment: MutableMapping[str, str]) -> bool:
    """Whether ROS is to stay on this machine; said by the range alone from then on."""
    if environment.get(LOCALHOST_ONLY) == "1":
        for name in (LOCALHOST_ONLY, PEERS):
            environment.pop(name, None)
        return True
    return environment.get(RANGE) == "LOCALHOST"
