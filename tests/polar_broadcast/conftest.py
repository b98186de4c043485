"""The air of virtual straps that tell their heart rate to everybody."""

from tests.rigs.bluetooth import *  # noqa: F403 - its fixtures and its hook
