"""The shape of the package: its versions and its launch file."""

from __future__ import annotations

import ast
import runpy
import sys
import tomllib
from pathlib import Path
from types import ModuleType
from typing import Any
from xml.etree import ElementTree

import pytest
import yaml

from lsl_to_ros.ros_to_lsl.parameters import NODE_OPTIONS

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


# The shape of the launch file.
LAUNCH_FILES = Path(__file__).parents[2] / "ros_side" / "lsl_to_ros" / "launch"
PARAMETERS = (
    "Sensor_Enable",
    "Chunk_Enable",
    "Chunk_Length",
    "topic_prefix",
    "stream_predicate",
    "processes",
    "session_id",
    "known_peers",
    "aliases",
    "compat",
    "use_sim_time",
)
NOTHING_GIVEN = {
    "namespace": "",
    "node_name": "lsl_to_ros",
    **dict.fromkeys(PARAMETERS, ""),
    "params_file": "",
    "log_level": "",
    "respawn": "",
}


class Noted:
    """Keeps what it was made with."""

    def __init__(self, *args: Any, **options: Any) -> None:
        self.args = args
        self.options = options


class Configuration(Noted):
    """Looks its value up in the context, which is a plain dictionary here."""

    def perform(self, context: dict[str, str]) -> str:
        return context[self.args[0]]


STAND_INS: dict[str, dict[str, type]] = {
    "launch": {"LaunchContext": dict, "LaunchDescription": Noted},
    "launch.actions": {"DeclareLaunchArgument": Noted, "OpaqueFunction": Noted},
    "launch.substitutions": {"LaunchConfiguration": Configuration},
    "launch_ros": {},
    "launch_ros.actions": {"Node": Noted},
    "launch_ros.parameter_descriptions": {"ParameterValue": Noted},
}


def _actions(monkeypatch: pytest.MonkeyPatch, file: str) -> list[Noted]:
    for name, members in STAND_INS.items():
        module = ModuleType(name)
        vars(module).update(members)
        monkeypatch.setitem(sys.modules, name, module)
    # It has kept the stand-ins of the test before.
    monkeypatch.delitem(sys.modules, "lsl_to_ros.launch_description", raising=False)
    description: Noted = runpy.run_path(str(LAUNCH_FILES / file))["generate_launch_description"]()
    (entities,) = description.args
    return entities


@pytest.fixture
def actions(monkeypatch: pytest.MonkeyPatch) -> list[Noted]:
    return _actions(monkeypatch, "lsl_to_ros.launch.py")


def _node(actions: list[Noted], **given: str) -> dict[str, Any]:
    (node,) = actions[-1].options["function"](NOTHING_GIVEN | given)
    return node.options


def test_every_argument_can_be_left_out(actions: list[Noted]) -> None:
    declared = {action.args[0]: action.options for action in actions[:-1]}
    defaults = {name: options["default_value"] for name, options in declared.items()}
    assert defaults == NOTHING_GIVEN
    # ros2 launch --show-args prints it.
    assert all(options["description"] for options in declared.values())


def test_it_starts_the_node_that_is_installed(actions: list[Noted]) -> None:
    node = _node(actions)
    assert (node["package"], node["executable"]) == ("lsl_to_ros", "lsl_to_ros")


def test_name_and_namespace_are_the_arguments(actions: list[Noted]) -> None:
    node = _node(actions)
    for option, argument in {"name": "node_name", "namespace": "namespace"}.items():
        assert type(node[option]) is Configuration
        assert node[option].args == (argument,)


def test_what_is_not_given_does_not_overrule_a_parameter_file(
    actions: list[Noted], lab_yaml: str
) -> None:
    assert _node(actions)["parameters"] == []
    assert _node(actions, params_file=lab_yaml)["parameters"] == [lab_yaml]


def test_a_file_that_is_not_there_is_refused(
    actions: list[Noted], lab_yaml: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HOME", str(Path(lab_yaml).parent))
    # As ros2 launch passes it: no shell expands what stands behind the sign.
    assert _node(actions, params_file="~/lab.yaml")["parameters"] == [lab_yaml]
    with pytest.raises(FileNotFoundError, match=r"there is no file ~/nofile\.yaml"):
        _node(actions, params_file="~/nofile.yaml")


@pytest.fixture
def lab_yaml(tmp_path: Path) -> str:
    file = tmp_path / "lab.yaml"
    file.touch()
    return str(file)


def test_what_is_given_comes_after_the_file_and_keeps_its_type(
    actions: list[Noted], lab_yaml: str
) -> None:
    file, given = _node(
        actions,
        params_file=lab_yaml,
        topic_prefix="7",
        stream_predicate="type='EEG'",
        processes="2",
        session_id="42",
        known_peers="[a, b]",
    )["parameters"]
    assert file == lab_yaml
    names = ("topic_prefix", "stream_predicate", "processes", "session_id", "known_peers")
    assert {name: value.args[0].args[0] for name, value in given.items()} == {
        name: name for name in names
    }
    types = {name: value.options["value_type"] for name, value in given.items()}
    assert {types[name] for name in ("topic_prefix", "stream_predicate", "session_id")} == {str}
    assert types["processes"] is int
    # launch compares with typing's alias and refuses the plain list[str].
    assert repr(types["known_peers"]) == "typing.List[str]"


def test_the_length_of_chunks_is_a_number_and_switches_are_switches(actions: list[Noted]) -> None:
    (given,) = _node(
        actions, Chunk_Length="20", Chunk_Enable="false", Sensor_Enable="true", use_sim_time="true"
    )["parameters"]
    types = {name: value.options["value_type"] for name, value in given.items()}
    assert types == {
        "Chunk_Length": int,
        "Chunk_Enable": bool,
        "Sensor_Enable": bool,
        "use_sim_time": bool,
    }


def test_it_can_be_started_again_and_say_more(actions: list[Noted]) -> None:
    usual, other = _node(actions), _node(actions, respawn="true", log_level="debug")
    assert (usual["respawn"], usual["ros_arguments"]) == (False, [])
    assert (other["respawn"], other["ros_arguments"]) == (True, ["--log-level", "debug"])
    with pytest.raises(ValueError, match="respawn must be true or false, not 'yess'"):
        _node(actions, respawn="yess")


@pytest.mark.parametrize("name", PARAMETERS)
def test_each_parameter_can_be_given_alone(actions: list[Noted], name: str) -> None:
    (given,) = _node(actions, **{name: "x"})["parameters"]
    assert list(given) == [name]


def test_the_second_node_has_a_file_of_its_own(
    monkeypatch: pytest.MonkeyPatch, lab_yaml: str
) -> None:
    *declared, start = _actions(monkeypatch, "ros_to_lsl.launch.py")
    nothing = {action.args[0]: action.options["default_value"] for action in declared}
    assert all(action.options["description"] for action in declared)
    assert {name: value for name, value in nothing.items() if value} == {"node_name": "ros_to_lsl"}
    (node,) = start.options["function"](nothing)
    assert (node.options["executable"], node.options["parameters"]) == ("ros_to_lsl", [])
    given = nothing | {"topics": "[/odom]", "all_small": "true", "params_file": lab_yaml}
    (node,) = start.options["function"](given)
    file, parameters = node.options["parameters"]
    assert file == lab_yaml
    types = {name: value.options["value_type"] for name, value in parameters.items()}
    assert repr(types.pop("topics")) == "typing.List[str]"
    assert types == {"all_small": bool}
    assert parameters.keys() <= NODE_OPTIONS.keys()
    assert nothing.keys() - NODE_OPTIONS.keys() == {
        "namespace",
        "node_name",
        "params_file",
        "log_level",
        "respawn",
        "use_sim_time",
    }


@pytest.mark.parametrize("node", ["lsl_to_ros", "ros_to_lsl"])
def test_xml_and_yaml_take_the_same_arguments_and_start_the_same(
    monkeypatch: pytest.MonkeyPatch, node: str
) -> None:
    *declared, _ = _actions(monkeypatch, f"{node}.launch.py")
    expected = [
        (each.args[0], each.options["default_value"], each.options["description"])
        for each in declared
    ]
    fields = ("name", "default", "description")
    # A string in quotes alone: YAML would make something else of an empty one.
    *arguments, started = yaml.safe_load((LAUNCH_FILES / f"{node}.launch.yaml").read_text())[
        "launch"
    ]
    assert [tuple(each["arg"][field] for field in fields) for each in arguments] == expected
    root = ElementTree.parse(LAUNCH_FILES / f"{node}.launch.xml").getroot()
    assert [tuple(map(each.get, fields)) for each in root.findall("arg")] == expected
    (included,) = root.findall("include")
    # Without arguments of its own it sees all of them.
    assert included.attrib == started["include"] == {"file": f"$(dirname)/{node}.launch.py"}
