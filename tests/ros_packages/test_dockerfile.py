"""The image's recipe agrees with the manifests, the locks and the tree.

No container engine runs here: that the image can be built is not shown.
"""

from __future__ import annotations

import re
import subprocess
from pathlib import Path
from xml.etree import ElementTree

import pytest

from tests.ros_packages import dockerfile
from tests.ros_packages.dockerfile import Instruction

ROOT = Path(__file__).parents[2]
FOLDER = ROOT / "ros_side" / "docker"
MANIFESTS = [
    ROOT / "common" / "package.xml",
    ROOT / "ros_side" / "biosensor_msgs" / "package.xml",
    ROOT / "ros_side" / "lsl_to_ros" / "package.xml",
]
# Tags that name the distribution, the set of packages and the release of Ubuntu.
IMAGE = re.compile(r"ros:jazzy-ros-(core|base)-noble")
RUN_TIME = ("depend", "exec_depend")


@pytest.fixture
def build() -> list[Instruction]:
    return dockerfile.stages(dockerfile.read(FOLDER / "Dockerfile"))[0]


@pytest.fixture
def final() -> list[Instruction]:
    return dockerfile.stages(dockerfile.read(FOLDER / "Dockerfile"))[-1]


def _all(stage: list[Instruction], name: str) -> list[Instruction]:
    return [instruction for instruction in stage if instruction.name == name]


def _apt_packages(stage: list[Instruction]) -> list[str]:
    (command,) = (run.value for run in _all(stage, "RUN") if "apt-get install" in run.value)
    install = re.search(r"apt-get install (.*?)&&", command)
    assert install
    return [word for word in install[1].split() if not word.startswith("--")]


def test_the_images_are_pinned_by_tag() -> None:
    stages = dockerfile.stages(dockerfile.read(FOLDER / "Dockerfile"))
    assert len(stages) == 2
    assert all(IMAGE.fullmatch(stage[0].words[0]) for stage in stages)
    # Nothing else, not even a frontend, is fetched by a name that moves.
    assert "syntax=" not in (FOLDER / "Dockerfile").read_text()


def test_pylsl_is_the_locked_one(build: list[Instruction]) -> None:
    locked = re.search(
        r"^pylsl==(\S+)", (ROOT / "requirements" / "ros.txt").read_text(), re.MULTILINE
    )
    assert locked
    (pip,) = (run.value for run in _all(build, "RUN") if "pip install" in run.value)
    assert f"pylsl=={locked[1]}" in pip.split()
    # numpy is apt's; another one would not fit the compiled messages.
    assert {"--no-deps", "--no-cache-dir"} <= set(pip.split())
    assert "--system-site-packages" in pip.split()


def test_what_runs_has_the_packages_that_the_manifests_name(final: list[Instruction]) -> None:
    roots = [ElementTree.parse(path).getroot() for path in MANIFESTS]
    own = {root.findtext("name") for root in roots}
    keys = {
        element.text or ""
        for root in roots
        for tag in RUN_TIME
        for element in root.findall(tag)
        if element.text not in own
    }
    packages = {
        key if key.startswith("python3-") else f"ros-jazzy-{key.replace('_', '-')}" for key in keys
    }
    assert _apt_packages(final) == sorted(packages)


def test_package_lists_are_not_left_in_a_layer() -> None:
    runs = _all(dockerfile.read(FOLDER / "Dockerfile"), "RUN")
    installs = [run.value for run in runs if "apt-get" in run.value]
    assert len(installs) == 2
    for command in installs:
        assert "--no-install-recommends" in command
        assert command.endswith("rm -rf /var/lib/apt/lists/*")


def test_the_node_does_not_run_as_root(final: list[Instruction]) -> None:
    (user,) = _all(final, "USER")
    number, _, group = user.value.partition(":")
    assert int(number) > 0
    assert int(group) > 0
    # Nothing is changed after it but what is started.
    after = {instruction.name for instruction in final[final.index(user) + 1 :]}
    assert after == {"ENTRYPOINT", "CMD"}


def test_the_command_is_the_node_and_gets_the_signals(final: list[Instruction]) -> None:
    (entry,), (command,) = _all(final, "ENTRYPOINT"), _all(final, "CMD")
    assert entry.exec_form == ["/entrypoint.sh"]
    assert command.exec_form == ["lsl_to_ros"]
    setup = (ROOT / "ros_side" / "lsl_to_ros" / "setup.py").read_text()
    assert '"lsl_to_ros = lsl_to_ros.node:main"' in setup


def test_the_path_leads_to_where_colcon_installs_the_node(
    build: list[Instruction], final: list[Instruction]
) -> None:
    (colcon,) = (run.value for run in _all(build, "RUN") if "colcon build" in run.value)
    base = re.search(r"--merge-install --install-base (\S+)", colcon)
    assert base
    path = next(env.value for env in _all(final, "ENV") if env.value.startswith("PATH="))
    assert path == f"PATH={base[1]}/lib/lsl_to_ros:$PATH"
    assert f"source {base[1]}/setup.bash" in (FOLDER / "entrypoint.sh").read_text()
    assert base[1] in {copy.words[0] for copy in _all(final, "COPY") if "from" in copy.flags}


def test_the_interpreter_of_the_node_comes_along(
    build: list[Instruction], final: list[Instruction]
) -> None:
    # The script's first line names the Python that has run colcon.
    (colcon,) = (run.value for run in _all(build, "RUN") if "colcon build" in run.value)
    assert "/opt/venv/bin/python3 -m colcon build" in colcon
    copies = [copy.words for copy in _all(final, "COPY") if copy.flags.get("from") == "build"]
    assert ["/opt/venv", "/opt/venv"] in copies


def test_what_is_copied_exists_and_is_sent() -> None:
    patterns = (FOLDER / "Dockerfile.dockerignore").read_text().splitlines()
    rules = [line for line in patterns if line and not line.startswith("#")]
    assert rules[0] == "*"
    sent = {rule.removeprefix("!") for rule in rules if rule.startswith("!")}
    copies = _all(dockerfile.read(FOLDER / "Dockerfile"), "COPY")
    sources = {copy.words[0] for copy in copies if "from" not in copy.flags}
    assert sources == sent
    assert all((ROOT / source).exists() for source in sources)


def test_a_failed_import_fails_the_build(final: list[Instruction]) -> None:
    checks = [run for run in _all(final, "RUN") if run.value.startswith("[")]
    assert [check.exec_form[-1] for check in checks] == [
        "import lsl_to_ros.application, biosensor_msgs.msg"
    ]


@pytest.mark.nightly
def test_the_entry_point_becomes_the_command(tmp_path: Path) -> None:
    (tmp_path / "setup.bash").write_text("export SOURCED=yes\n")
    script = tmp_path / "entrypoint.sh"
    script.write_text(
        (FOLDER / "entrypoint.sh").read_text().replace("/opt/lsl_to_ros", str(tmp_path))
    )
    program = 'echo "$$ $SOURCED $# $1"; exit 7'
    command = ["bash", str(script), "bash", "-c", program, "bash", "a b", "*"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    output, _ = process.communicate(timeout=30)
    # The same process, the environment, the words as they are, and the exit code.
    assert output.split(maxsplit=3) == [str(process.pid), "yes", "2", "a b\n"]
    assert process.returncode == 7


@pytest.mark.nightly
def test_without_a_workspace_the_entry_point_says_so(tmp_path: Path) -> None:
    script = tmp_path / "entrypoint.sh"
    script.write_text(
        (FOLDER / "entrypoint.sh").read_text().replace("/opt/lsl_to_ros", str(tmp_path / "none"))
    )
    result = subprocess.run(
        ["bash", str(script), "echo", "started"], capture_output=True, text=True, check=False
    )
    assert result.returncode != 0
    assert "none/setup.bash" in result.stderr
    assert "started" not in result.stdout


def test_the_entry_point_can_be_executed() -> None:
    assert (FOLDER / "entrypoint.sh").stat().st_mode & 0o111
    assert (FOLDER / "entrypoint.sh").read_text().startswith("#!/bin/bash\n")
