"""The finished installer, and Windows PCs to run it on."""

from __future__ import annotations

import os
from collections.abc import Generator
from pathlib import Path

import pytest
from filelock import FileLock

from installer.layout import WORK, setup_file
from installer.stages import Build
from installer.wine.recipe import PACKAGE, PORTABLE
from tests.rigs.windows.pc import WindowsPc

# Disks are made beside the build, so that they can share its files.
DISKS = WORK / "pcs"
# An installer that was built elsewhere; what it is run on comes from the build all the same.
SETUP_VARIABLE = "BIOSENSOR_GATEWAY_SETUP"


@pytest.fixture(scope="session")
def setup() -> Path:
    """The installer, built if anything changed since it was, or the one that is to be tested."""
    given = os.environ.get(SETUP_VARIABLE)
    if given:
        return Path(given)
    WORK.mkdir(parents=True, exist_ok=True)
    with FileLock(WORK / "tests.lock"):
        build = Build(WORK)
        for stage in (PORTABLE, PACKAGE):
            build.bring_up_to_date(stage)
    return setup_file()


@pytest.fixture
def disk(request: pytest.FixtureRequest) -> Path:
    """Where a PC of this test can have its disk."""
    return _disk(request.node.name)


@pytest.fixture
def pc(disk: Path, setup: Path) -> Generator[WindowsPc]:
    """A PC without the program."""
    assert setup.is_file()
    with WindowsPc(disk) as pc:
        yield pc


@pytest.fixture(scope="module")
def installed(request: pytest.FixtureRequest, setup: Path) -> Generator[WindowsPc]:
    """A PC with the program, shared by the tests of a module that change nothing on it."""
    with WindowsPc(_disk(request.node.name)) as pc:
        ended = pc.install(setup)
        assert ended.returncode == 0, ended.stdout
        yield pc


@pytest.fixture(scope="module")
def bundle(installed: WindowsPc) -> Path:
    """Folder of the installed program."""
    return installed.program_folder


def _disk(name: str) -> Path:
    folder = DISKS / "".join(letter if letter.isalnum() else "-" for letter in name)
    assert not folder.exists(), f"left over from a run that was killed: remove {folder}"
    return folder
