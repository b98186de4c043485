"""Agent, page and node in containers find each other; the development container runs tests."""

from __future__ import annotations

import json
import os
import re
import subprocess
from pathlib import Path
from typing import Any
from urllib.request import HTTPCookieProcessor, build_opener

import pytest

from tests.containers.conftest import BASE, CERTIFICATES, ROOT, Engine, needs

MISSING = needs()

pytestmark = [
    pytest.mark.nightly,
    pytest.mark.timeout(3600),
    pytest.mark.skipif(bool(MISSING), reason=f"NOT RUN: {MISSING}"),
]

READ_ONE = """
import rclpy
from std_msgs.msg import Float32
rclpy.init()
node = rclpy.create_node("reader")
heard = []
node.create_subscription(Float32, "/p01/biosensors/ble_heart_rate/hr", heard.append, 10)
while not heard:
    rclpy.spin_once(node)
print("heart rate", heard[0].data)
"""


def ended(process: subprocess.Popen[str]) -> str:
    """Wait for the end of a program, which is to end well; return what it has said."""
    said, _ = process.communicate(timeout=600)
    assert process.returncode == 0, said
    return said


def test_a_heart_rate_comes_from_one_container_to_the_other(engine: Engine) -> None:
    variables = {
        name: os.environ[name] for name in ("ROS_DOMAIN_ID", "ROS_AUTOMATIC_DISCOVERY_RANGE")
    }
    variables |= {
        "LSLAPICFG": "/tmp/lsl_api.cfg",
        "PYTHON_KEYRING_BACKEND": "keyring.backends.null.Keyring",
        "BIOSENSOR_GATEWAY_BROADCAST": "127.0.0.1",
    }
    agent, node = (
        engine.run("from", f"biosensor-gateway-{each}").split()[-1] for each in ("agent", "node")
    )
    for each in (agent, node):
        engine.run("copy", each, os.environ["LSLAPICFG"], "/tmp/lsl_api.cfg")
    program = "biosensor-gateway"
    streaming = engine.start(
        agent, program, "run", "--no-ask", "--simulate", "ble_heart_rate@p01", variables=variables
    )
    ended(engine.start(agent, program, "wait-ready", "--timeout", "120", variables=variables))
    bridging = engine.start(node, "lsl_to_ros", variables=variables)
    said = ended(engine.start(node, "python3", "-c", READ_ONE, variables=variables))
    assert re.search(r"^heart rate [4-9]\d\.0$", said, re.MULTILINE), said
    page = engine.start(agent, program, "page", "--no-open", variables=variables)
    assert page.stdout is not None
    address = next(found[0] for line in page.stdout if (found := re.search(r"http://\S+", line)))
    # Its door gives a cookie.
    with build_opener(HTTPCookieProcessor()).open(address) as shown:
        assert b"<title>Biosensor Gateway" in shown.read()
    ended(engine.start(agent, program, "page", "--end", variables=variables))
    ended(engine.start(agent, program, "stop", variables=variables))
    ended(page)
    ended(streaming)
    bridging.terminate()
    assert "ble_heart_rate/hr (std_msgs/msg/Float32)" in bridging.communicate(timeout=60)[0]


@pytest.mark.parametrize(("image", "most_mb"), [("agent", 450.0), ("node", 650.0)])
def test_an_image_is_not_much_larger_than_the_documents_say(
    engine: Engine, image: str, most_mb: float
) -> None:
    sizes = {
        name: each["size"]
        for each in json.loads(engine.run("images", "--json"))
        for name in each["names"] or ()
    }
    (size,) = (size for name, size in sizes.items() if f"gateway-{image}:" in name)
    number, unit = size.split()
    assert unit == "MB", sizes
    assert float(number) < most_mb, sizes


FOLDER = ROOT / ".devcontainer"
LIMIT_S = 3300.0


def settings() -> dict[str, Any]:
    """Return what an editor reads, where a line may be a comment."""
    text = (FOLDER / "devcontainer.json").read_text(encoding="utf-8")
    return json.loads(re.sub(r"(?m)^\s*//.*$", "", text))


def test_the_unit_tests_pass_in_it_without_root(engine: Engine, tmp_path: Path) -> None:
    told = settings()
    engine.run(
        *("build", "--tag", "biosensor-gateway-dev", "--build-arg", f"BASE={BASE}"),
        *("--volume", f"{CERTIFICATES}:{CERTIFICATES}:ro"),
        *("--file", FOLDER / told["build"]["dockerfile"], FOLDER),
    )
    container = engine.run("from", "biosensor-gateway-dev").split()[-1]
    clone = tmp_path / "repository"
    subprocess.run(["git", "clone", "--quiet", "--no-local", ROOT, clone], check=True)
    there = f"/home/{told['remoteUser']}/repository"
    engine.run("copy", "--chown", "1000:1000", container, clone, there)
    engine.run("copy", container, CERTIFICATES, CERTIFICATES)
    # Where a name does not say, pip is told of the system's certificates.
    variables = {name: os.environ[name] for name in ("PIP_CERT",) if name in os.environ}
    prepare = told["postCreateCommand"]
    commands = f"cd {there} && id -un && {prepare} && make test"
    process = engine.start(container, "sh", "-c", commands, variables=variables)
    said, _ = process.communicate(timeout=LIMIT_S)
    assert process.returncode == 0, said[-8000:]
    assert said.startswith(f"{told['remoteUser']}\n")
    assert re.search(r"\d+ passed", said), said[-8000:]
