"""Isolation: no test sees, or is seen by, anything outside its own run."""

from __future__ import annotations

import asyncio
import atexit
import os
import shutil
import tempfile
import uuid
from collections.abc import Callable, Generator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from hypothesis import HealthCheck, settings

from tests.rigs.processes import let_programs_be_interrupted
from tests.slots import lsl_ports, take_slot
from tests.tiers.tier import Tier, is_in_memory, tier_of

if TYPE_CHECKING:
    from biosensor_gateway.simulation.world import World

pytest_plugins = ["tests.rigs.not_here", "tests.tiers.plugin", "tests.time_spent.plugin"]

let_programs_be_interrupted()

# How long an example takes says more of who else works on this machine.
_ANY_TIME = settings(deadline=None, suppress_health_check=[HealthCheck.too_slow])
# The same examples each time find nothing new; more of them, and others, are for `make explore`.
settings.register_profile("tests", _ANY_TIME, derandomize=True, max_examples=40)
settings.register_profile("explore", _ANY_TIME, derandomize=False, max_examples=1000)
settings.load_profile("tests")

_folder = Path(tempfile.mkdtemp(prefix="biosensor-gateway-tests-"))
atexit.register(shutil.rmtree, _folder, ignore_errors=True)

SESSION = f"test-{uuid.uuid4().hex}"
_slot = take_slot()
_discovery_port, _first_port = lsl_ports(_slot)

# liblsl reads its configuration at its first call, so this must come before any test
# module is imported. Child processes inherit it. ResolveScope keeps it on this machine.
_lsl_config = _folder / "lsl_api.cfg"
_lsl_config.write_text(
    f"[lab]\nSessionID = {SESSION}\nKnownPeers = {{127.0.0.1}}\n"
    "[multicast]\nResolveScope = machine\n"
    f"[ports]\nMulticastPort = {_discovery_port}\nBasePort = {_first_port}\nPortRange = 256\n"
    "[log]\nlevel = -2\n"
)
os.environ["LSLAPICFG"] = str(_lsl_config)
os.environ["ROS_DOMAIN_ID"] = str(_slot)
os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
# What crashes, or is aborted because it hangs, says where.
os.environ["PYTHONFAULTHANDLER"] = "1"
# Jazzy's messages do not check their fields otherwise.
os.environ["ROS_PYTHON_CHECK_FIELDS"] = "1"
# Who looks for devices of the Wi-Fi asks the whole network otherwise.
os.environ["BIOSENSOR_GATEWAY_BROADCAST"] = "127.0.0.1"
# Looking for the keyring of this computer starts programs, and would find its secrets.
os.environ["PYTHON_KEYRING_BACKEND"] = "keyring.backends.fail.Keyring"
os.environ["BIOSENSOR_GATEWAY_STATE"] = str(_folder / "state")
os.environ["BIOSENSOR_GATEWAY_SETTINGS"] = str(_folder / "settings.toml")


def pytest_asyncio_loop_factories(
    item: pytest.Item,
) -> Mapping[str, Callable[[], asyncio.AbstractEventLoop]]:
    """Let the loops of unit tests go by virtual time, and those of others by the system's.

    Which it is shows when the loop is made: a mark of a parameter is not known before.
    """
    from tests.rigs.virtual_time import loop_of_the_test  # noqa: PLC0415 - LSL comes later

    del item
    return {"of the test": loop_of_the_test}


@pytest.fixture(autouse=True)
def _links_are_in_memory(  # pyright: ignore[reportUnusedFunction]
    request: pytest.FixtureRequest,
) -> Generator[None]:
    """Sockets, serial ports, LSL outlets and all clocks; see tests/rigs/memory_links.py."""
    if not is_in_memory(request.node):
        yield
        return
    from biosensor_gateway.streaming import outlets  # noqa: PLC0415 - LSL comes later
    from tests.rigs.memory_links import MemoryOutlet, links_in_memory  # noqa: PLC0415 - see above
    from tests.rigs.virtual_time import patience_without_limit  # noqa: PLC0415 - see above

    # Not the fixture: made before all others, it would undo what tests patch after them.
    with links_in_memory(), patience_without_limit(), pytest.MonkeyPatch.context() as patch:
        patch.setattr(outlets, "LslOutlet", MemoryOutlet)
        # No bus to ask for BlueZ.
        patch.setenv("DBUS_SYSTEM_BUS_ADDRESS", "none")
        patch.setenv("DBUS_SESSION_BUS_ADDRESS", "none")
        yield


@pytest.fixture
def world() -> Generator[World]:
    """Where virtual devices live."""
    from biosensor_gateway.simulation.world import World  # noqa: PLC0415 - LSL comes later

    with World() as living:
        yield living


@pytest.fixture(scope="module", autouse=True)
def _no_program_outlives_its_tests(  # pyright: ignore[reportUnusedFunction]
    request: pytest.FixtureRequest,
) -> Generator[None]:
    """Whoever started it must end it; what is left is ended here, and told."""
    yield
    own = [each for each in request.session.items if each.path == request.path]
    if all(tier_of(each) is Tier.UNIT for each in own):
        return
    from tests.rigs.processes import OF_A_RUN, end_all, outliving  # noqa: PLC0415 - not for all

    left = end_all(outliving(OF_A_RUN, _lsl_config))
    assert not left, f"programs outlived their tests: {'; '.join(left)}"


@pytest.fixture(scope="module", autouse=True)
def _no_outlet_is_left_from_before() -> None:  # pyright: ignore[reportUnusedFunction]
    """A module's tests would see it, and record it."""
    from tests.open_outlets import open_outlets, watch_outlets  # noqa: PLC0415 - LSL comes later

    watch_outlets()
    assert not open_outlets(), "the tests before these left outlets open"
