"""package.xml names what the package imports, and nothing else.

rosdep installs by it and colcon orders by it, but neither looks into the code.
"""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Iterator
from importlib import metadata
from pathlib import Path
from xml.etree import ElementTree

import pytest
import yaml

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "ros_side" / "lsl_to_ros"
FOLDERS = [ROOT / "common", ROOT / "ros_side" / "biosensor_msgs", PACKAGE]
SOURCES = sorted([*(PACKAGE / "lsl_to_ros").rglob("*.py"), *(PACKAGE / "launch").glob("*.py")])
# Import names whose rosdep key is another.
KEYS = {"numpy": "python3-numpy"}
# No rosdep key: setup.py names it.
FROM_PYPI = {"pylsl"}
OPTIONAL = {"biosensor_msgs"}
# Of launch files that are not Python.
FRONT_ENDS = {".xml": "launch_xml", ".yaml": "launch_yaml"}


def _manifest() -> ElementTree.Element:
    return ElementTree.parse(PACKAGE / "package.xml").getroot()


def _named() -> dict[str, list[str]]:
    """Dependencies by their tags, of every kind that the format knows."""
    named: dict[str, list[str]] = {}
    for element in _manifest():
        if element.tag.endswith("depend"):
            named.setdefault(element.tag, []).append(element.text or "")
    return named


def _imported_by(node: ast.AST) -> Iterator[str]:
    """Top-level names that a piece of code imports."""
    for part in ast.walk(node):
        if isinstance(part, ast.Import):
            yield from (alias.name.partition(".")[0] for alias in part.names)
        elif isinstance(part, ast.ImportFrom) and part.module and not part.level:
            yield part.module.partition(".")[0]


def test_the_manifest_names_what_is_imported_and_nothing_else() -> None:
    imported = {name for path in SOURCES for name in _imported_by(ast.parse(path.read_text()))}
    foreign = imported - set(sys.stdlib_module_names) - {PACKAGE.name}
    assert foreign >= FROM_PYPI
    keys = {KEYS.get(name, name) for name in foreign - FROM_PYPI - OPTIONAL}
    suffixes = {path.suffix for path in (PACKAGE / "launch").glob("*.launch.*")} - {".py"}
    keys |= {FRONT_ENDS[suffix] for suffix in suffixes}
    assert _named() == {
        "exec_depend": [*sorted(keys), *OPTIONAL],
        "test_depend": ["python3-pytest"],
    }


def test_what_is_optional_is_taken_out_by_a_variable() -> None:
    conditions = {each.text: each.get("condition") for each in _manifest().findall("exec_depend")}
    assert {name: text for name, text in conditions.items() if text} == {
        "biosensor_msgs": "$BIOSENSOR_MSGS != 0"
    }


@pytest.mark.parametrize("folder", FOLDERS, ids=lambda folder: folder.name)
def test_each_package_has_what_bloom_and_the_index_of_ros_look_for(folder: Path) -> None:
    manifest = ElementTree.parse(folder / "package.xml").getroot()
    name = manifest.findtext("name") or ""
    (licence,) = manifest.findall("license")
    assert (folder / (licence.get("file") or "")).read_bytes() == (ROOT / "LICENSE").read_bytes()
    urls = {url.get("type") for url in manifest.findall("url")}
    assert urls == {"website", "repository", "bugtracker"}
    assert manifest.findtext("author")
    file = folder / (manifest.findtext("export/rosdoc2") or "")
    kind, documents = yaml.safe_load_all(file.read_text())
    assert kind == {"type": "rosdoc2 config", "version": 1}
    # Both must be there, or nothing is built.
    assert documents.keys() == {"settings", "builders"}
    assert (folder / "README.md").read_text().startswith(f"# {name}\n")
    assert f" {name}\n" in (folder / "QUALITY_DECLARATION.md").read_text()
    bar, title, below, *rest = (folder / "CHANGELOG.rst").read_text().splitlines()
    assert title == f"Changelog for package {name}"
    assert bar == below == "^" * len(title)
    version = manifest.findtext("version") or ""
    # What catkin_prepare_release makes of the first.
    assert rest[1] == "Forthcoming" or rest[1].startswith(f"{version} (")
    assert list((folder / "test").glob("test_*.py"))


@pytest.mark.parametrize("folder", FOLDERS, ids=lambda folder: folder.name)
def test_the_tests_of_a_package_need_nothing_of_the_repository(folder: Path) -> None:
    imported = {
        name
        for path in (folder / "test").glob("*.py")
        for name in _imported_by(ast.parse(path.read_text()))
    }
    assert not imported & {"tests", "biosensor_gateway", "hypothesis"}


@pytest.mark.nightly
def test_the_node_can_be_imported_without_what_is_optional() -> None:
    # None in sys.modules makes an import fail as that of a missing package does.
    hide = "".join(f"sys.modules[{name!r}] = None; " for name in OPTIONAL)
    program = f"import sys; {hide}import lsl_to_ros.application"
    result = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=False
    )
    assert result.returncode == 0, result.stderr


def test_setup_names_what_comes_from_pypi() -> None:
    (call,) = (
        node
        for node in ast.walk(ast.parse((PACKAGE / "setup.py").read_text()))
        if isinstance(node, ast.Call) and ast.unparse(node.func) == "setup"
    )
    (required,) = (word.value for word in call.keywords if word.arg == "install_requires")
    names = {requirement.partition(">")[0] for requirement in ast.literal_eval(required)}
    assert names == FROM_PYPI


def test_numpy_from_apt_is_what_pylsl_needs() -> None:
    # Else pip would put another one over the one that the messages were built with.
    requirements = metadata.requires("pylsl") or []
    assert [text for text in requirements if "extra" not in text] == ["numpy<3,>=1.21"]


def test_colcon_builds_it_by_the_type_that_it_exports() -> None:
    assert _manifest().findtext("export/build_type") == "ament_python"


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
