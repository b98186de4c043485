"""setup.py installs every file that is not code, where ROS looks for it."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.nightly

PACKAGE = Path(__file__).parents[2] / "ros_side" / "lsl_to_ros"
SHARE = Path("share", "lsl_to_ros")
MARKER = Path("share", "ament_index", "resource_index", "packages", "lsl_to_ros")


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    target = tmp_path_factory.mktemp("installed")
    command = [sys.executable, "setup.py", "--quiet", "install_data", "--install-dir", str(target)]
    result = subprocess.run(command, cwd=PACKAGE, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr
    return target


def _files(folder: Path) -> set[Path]:
    return {
        path.relative_to(folder)
        for path in folder.rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }


@pytest.mark.seam
def test_the_share_folder_has_every_launch_and_configuration_file(installed: Path) -> None:
    sources = {
        Path(folder, name) for folder in ("launch", "config") for name in _files(PACKAGE / folder)
    }
    assert {path.name for path in sources} >= {"params.yaml", "ros_to_lsl.yaml"}
    assert _files(installed / SHARE) == sources | {Path("package.xml")}
    for path in sources:
        assert (installed / SHARE / path).read_bytes() == (PACKAGE / path).read_bytes()


@pytest.mark.seam
def test_nothing_else_is_installed_but_ament_s_marker(installed: Path) -> None:
    assert {path for path in _files(installed) if SHARE not in path.parents} == {MARKER}
