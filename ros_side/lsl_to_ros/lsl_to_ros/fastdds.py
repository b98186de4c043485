"""Fast DDS, ROS's usual middleware, set for a network that loses packets."""

from __future__ import annotations

from collections.abc import MutableMapping
from importlib.resources import files
from pathlib import Path

# Fast DDS 2 reads the first, Fast DDS 3 the second.
VARIABLES = ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE")
IN_FOLDER = ("DEFAULT_FASTRTPS_PROFILES.xml", "DEFAULT_FASTDDS_PROFILES.xml")


def use_our_profiles(environment: MutableMapping[str, str], folder: Path) -> bool:
    """Let Fast DDS repeat lost packets after 50 ms, unless the user has profiles.

    It has to be called before ROS starts; other middlewares take no notice.

    Parameters
    ----------
    environment
        Where Fast DDS looks for the name of its file.
    folder
        The working folder, where it looks otherwise.

    Returns
    -------
    bool
        Whether our profiles will be used.
    """
    has_own = any(environment.get(name) for name in VARIABLES)
    if has_own or any((folder / name).is_file() for name in IN_FOLDER):
        return False
    path = str(files("lsl_to_ros").joinpath("fastdds_profiles.xml"))
    environment.update(dict.fromkeys(VARIABLES, path))
    return True
