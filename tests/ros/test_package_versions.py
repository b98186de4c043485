import ast
import tomllib
from pathlib import Path
from xml.etree import ElementTree

import pytest

ROOT = Path(__file__).parents[2]
PACKAGES = {"biosensor_common": ROOT / "common", "lsl_to_ros": ROOT / "ros_side" / "lsl_to_ros"}


def _setup_arguments(path: Path) -> dict[str, str]:
    """Keywords of the call of ``setup`` whose values are literal texts."""
    (call,) = (
        node
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.Call) and ast.unparse(node.func) == "setup"
    )
    return {
        keyword.arg: keyword.value.value
        for keyword in call.keywords
        if keyword.arg
        and isinstance(keyword.value, ast.Constant)
        and isinstance(keyword.value.value, str)
    }


# bloom and catkin_prepare_release want literal versions in both files, so each has its own.
@pytest.mark.parametrize("folder", PACKAGES.values(), ids=PACKAGES.keys())
def test_the_ros_packages_have_the_version_of_the_distribution(folder: Path) -> None:
    version = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
    manifest = ElementTree.parse(folder / "package.xml").getroot()
    assert manifest.findtext("version") == version
    assert _setup_arguments(folder / "setup.py")["version"] == version


@pytest.mark.parametrize("folder", PACKAGES.values(), ids=PACKAGES.keys())
def test_manifest_and_setup_name_the_same_maintainer_and_license(folder: Path) -> None:
    manifest = ElementTree.parse(folder / "package.xml").getroot()
    (maintainer,) = manifest.findall("maintainer")
    arguments = _setup_arguments(folder / "setup.py")
    assert maintainer.text == arguments["maintainer"]
    assert maintainer.get("email") == arguments["maintainer_email"]
    assert manifest.findtext("license") == arguments["license"]


@pytest.mark.parametrize(("name", "folder"), PACKAGES.items(), ids=PACKAGES.keys())
def test_each_package_has_the_marker_by_which_ament_finds_it(name: str, folder: Path) -> None:
    assert ElementTree.parse(folder / "package.xml").getroot().findtext("name") == name
    assert (folder / "resource" / name).is_file()


def test_the_messages_have_the_version_and_the_owner_of_the_node() -> None:
    messages, node = (
        ElementTree.parse(ROOT / "ros_side" / name / "package.xml").getroot()
        for name in ("biosensor_msgs", "lsl_to_ros")
    )
    for field in ("version", "maintainer", "license"):
        assert messages.findtext(field) == node.findtext(field)
