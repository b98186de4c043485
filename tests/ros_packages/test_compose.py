"""compose.yaml keeps to the rules of the Compose specification that concern it."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
import yaml

from tests.ros_packages import dockerfile

FOLDER = Path(__file__).parents[2] / "ros_side" / "docker"
# The keys of the specification that are used; a misspelt one is none of them.
TOP = {"name", "services"}
SERVICE = {
    "build",
    "cap_drop",
    "command",
    "environment",
    "image",
    "logging",
    "network_mode",
    "read_only",
    "restart",
    "security_opt",
    "tmpfs",
    "volumes",
}
# Not allowed together with network_mode: host.
OF_OTHER_NETWORKS = {"dns", "expose", "hostname", "links", "networks", "ports"}
VARIABLE = re.compile(r"\$\{(?P<name>[A-Z_]+):-(?P<default>[^}]*)\}")


@pytest.fixture
def document() -> dict[str, Any]:
    return yaml.safe_load((FOLDER / "compose.yaml").read_text())


@pytest.fixture
def service(document: dict[str, Any]) -> dict[str, Any]:
    (name,) = document["services"]
    assert name == "lsl_to_ros"
    return document["services"][name]


def _with_defaults(text: str) -> str:
    return VARIABLE.sub(lambda match: match["default"], text)


def test_every_key_is_one_of_the_specification(
    document: dict[str, Any], service: dict[str, Any]
) -> None:
    assert set(document) == TOP
    assert re.fullmatch(r"[a-z0-9][a-z0-9_-]*", document["name"])
    assert set(service) == SERVICE
    assert not set(service) & OF_OTHER_NETWORKS


def test_it_is_in_the_network_of_the_host(service: dict[str, Any]) -> None:
    assert service["network_mode"] == "host"
    assert service["restart"] == "unless-stopped"


def test_it_builds_the_image_from_the_root_of_the_repository(service: dict[str, Any]) -> None:
    build = service["build"]
    assert set(build) == {"context", "dockerfile"}
    context = (FOLDER / build["context"]).resolve()
    assert (context / "pyproject.toml").is_file()
    assert context / build["dockerfile"] == FOLDER / "Dockerfile"
    assert re.fullmatch(r"[a-z0-9_./-]+:(?!latest)[\w.-]+", service["image"])


def test_each_variable_has_a_default_that_works() -> None:
    text = (FOLDER / "compose.yaml").read_text()
    assert text.count("$") == len(VARIABLE.findall(text))
    defaults = dict(VARIABLE.findall(text))
    assert set(defaults) == {"ROS_DOMAIN_ID", "PARAMS_FILE"}
    assert all(defaults.values())
    readme = (FOLDER / "README.md").read_text()
    assert all(f"`{name}`" in readme for name in defaults)


def test_the_environment_is_strings_or_what_is_passed_on(service: dict[str, Any]) -> None:
    environment = service["environment"]
    assert _with_defaults(environment.pop("ROS_DOMAIN_ID")) == "0"
    # A number or a truth value would be refused; nothing means "as it is outside".
    assert set(environment.values()) == {None}
    readme = (FOLDER / "README.md").read_text()
    assert all(f"`{name}`" in readme for name in environment)


def test_the_node_reads_the_file_that_is_mounted(service: dict[str, Any]) -> None:
    (volume,) = service["volumes"]
    assert set(volume) == {"type", "source", "target", "read_only", "bind"}
    assert (volume["type"], volume["read_only"]) == ("bind", True)
    assert volume["bind"] == {"create_host_path": False}
    source = _with_defaults(volume["source"])
    # Without the dot it would be the name of a volume.
    assert source.startswith("./")
    parameters = yaml.safe_load((FOLDER / source).read_text())
    assert set(parameters["/**"]) == {"ros__parameters"}
    assert service["command"] == ["lsl_to_ros", "--ros-args", "--params-file", volume["target"]]


def test_it_has_no_rights_that_it_does_not_need(service: dict[str, Any]) -> None:
    assert service["read_only"] is True
    assert service["cap_drop"] == ["ALL"]
    assert service["security_opt"] == ["no-new-privileges:true"]
    # Home and logs: the only place to write to.
    final = dockerfile.stages(dockerfile.read(FOLDER / "Dockerfile"))[-1]
    environment = {instruction.value for instruction in final if instruction.name == "ENV"}
    assert service["tmpfs"] == ["/tmp"]
    assert "HOME=/tmp" in environment


def test_its_log_cannot_fill_the_disk(service: dict[str, Any]) -> None:
    assert service["logging"] == {
        "driver": "json-file",
        "options": {"max-size": "10m", "max-file": "3"},
    }
