"""Puts the status of an agent and its devices into sentences."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from biosensor_common.refusal import Refusal
from biosensor_gateway.agent.state import STATE_WORDS


def restart_sentences(status: Mapping[str, Any]) -> Iterator[str]:
    """Say that the agent had died, if it had."""
    if status.get("restarts"):
        times = "once" if status["restarts"] == 1 else f"{status['restarts']} times"
        yield f"started again {times}, last after: {status['last_end']}"


def refusal_sentences(status: Mapping[str, Any]) -> Iterator[str]:
    """Say what was not passed on as it came, of an agent, a device or a stream."""
    for each in status.get("refusals", ()):
        yield each["sentence"] + ("" if each["now"] else " (not lately)")


def refused_now(status: Mapping[str, Any]) -> dict[str, str]:
    """Return what is not passed on as it came now: of an agent alone, or of a device and streams.

    Returns
    -------
    dict of str
        Sentences by what they are about, whose counts may grow; a pause is said by the state.
    """
    return {
        f"{source} {told['what']} {told.get('about', '')}": (
            f"{source}: {told['sentence']}" if source else told["sentence"]
        )
        for source, part in (("", status), *status.get("streams", {}).items())
        for told in part.get("refusals", ())
        if told["now"] and told["what"] != Refusal.PAUSED.word
    }


def device_sentence(device: Mapping[str, Any]) -> str:
    """Say who wears a device, how it does, and what is wrong."""
    name = " ".join(
        part for part in (device["participant"], device["sensor"], device["label"]) if part
    )
    word = STATE_WORDS.get(device["state"], device["state"])
    state = f"paused ({word})" if device["paused"] else word
    line = f"{name} ({device['unit']}): {state}"
    return line + (f" - {device['error']}" if device["error"] else "")
