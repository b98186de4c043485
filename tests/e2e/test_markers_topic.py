"""A marker of the experimenter reaches ROS, with nothing said of it on the ROS side."""

from __future__ import annotations

import json
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import pytest
from std_msgs.msg import String

from biosensor_common.errors import GatewayError
from biosensor_gateway.agent import control
from biosensor_gateway.settings.places import state_folder

pytestmark = pytest.mark.nightly


@pytest.mark.seam
def test_a_marker_is_a_string_with_its_text(
    programs: Any, listener: Any, wait_until: Callable[..., None]
) -> None:
    messages = listener.listen(String, "/biosensors/gateway/markers")
    programs.node()
    programs.agent("")

    def marked() -> dict[str, Any]:
        return control.ask(state_folder(), "mark", {"marker": "Stück 1", "kind": "button"})

    def heard() -> list[dict[str, Any]]:
        return [json.loads(message.data) for message in messages]

    def is_heard() -> bool:
        # Until the node and its subscriber are there, nobody hears a marker.
        with suppress(GatewayError):
            marked()
        return bool(heard())

    wait_until(is_heard, "a first marker")
    sent = marked()
    wait_until(lambda: heard()[-1]["id"] == sent["id"], "the marker")
    assert heard()[-1] == {"marker": "Stück 1", "kind": "button", **sent}
    undone = control.ask(state_folder(), "undo-marker")
    wait_until(lambda: heard()[-1]["id"] == undone["id"], "its undoing")
    assert (heard()[-1]["kind"], heard()[-1]["of"]) == ("undo", sent["id"])
    ids = [each["id"] for each in heard()]
    assert ids == list(range(ids[0], undone["id"] + 1))
