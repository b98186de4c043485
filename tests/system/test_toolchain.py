"""What must be there to build the ROS packages, and what is said when it is not."""

from __future__ import annotations

import sysconfig
from pathlib import Path

import pytest

from tests.system.toolchain import (
    BUILD_TOOLS,
    BuildToolMissingError,
    fix_header_paths,
    require_build_tools,
)

pytestmark = pytest.mark.system


def _folder_with(programs: set[str], folder: Path) -> str:
    for name in programs:
        (folder / name).touch(0o755)
    return str(folder)


@pytest.mark.parametrize("tool", BUILD_TOOLS)
def test_a_missing_tool_is_named_with_its_package(tool: str, tmp_path: Path) -> None:
    path = _folder_with(BUILD_TOOLS.keys() - {tool}, tmp_path)
    with pytest.raises(BuildToolMissingError) as raised:
        require_build_tools(path)
    assert str(raised.value) == (
        f"colcon cannot build the ROS packages without {tool}:"
        f" install {BUILD_TOOLS[tool]} (Debian's names)."
    )


def test_missing_headers_of_python_are_named(tmp_path: Path) -> None:
    path = _folder_with(set(BUILD_TOOLS), tmp_path)
    with pytest.raises(BuildToolMissingError, match=r"without \S+/Python\.h: install python3-dev "):
        require_build_tools(path, headers=tmp_path / "include")


def test_the_wheels_name_the_headers_of_this_machine(tmp_path: Path) -> None:
    built_at = "/opt/python/cp312-cp312"
    headers = f"{built_at}/include/python3.12"
    numpy_headers = f"{built_at}/lib/python3.12/site-packages/numpy/_core/include"
    cached = tmp_path / "cached.cmake"
    cached.write_text(f'DIRECTORIES "{headers};{numpy_headers};${{prefix}}/include"\n')
    installed = tmp_path / "venv" / "share" / "std_msgs" / "cmake" / "targets.cmake"
    installed.parent.mkdir(parents=True)
    installed.hardlink_to(cached)
    fix_header_paths(tmp_path / "venv", python="/usr/include/python3.12", numpy="/numpy/include")
    assert installed.read_text() == (
        'DIRECTORIES "/usr/include/python3.12;/numpy/include;${prefix}/include"\n'
    )
    assert built_at in cached.read_text()


def test_this_machine_has_all_tools() -> None:
    require_build_tools()
    assert (Path(sysconfig.get_path("include")) / "Python.h").is_file()
