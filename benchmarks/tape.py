"""Calls of a decoder, taped while its driver makes them and played to a new one."""

from __future__ import annotations

import time
from collections.abc import Callable, Generator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pkgutil import resolve_name
from typing import Any
from unittest.mock import patch


@dataclass(frozen=True, slots=True)
class Taped:
    """What is taped of a sensor's driver; places are ``module:name``."""

    functions: Sequence[str] = ()  # Functions of the decoder, in the modules that call them.
    decoder: str = ""  # Class of the decoder, if it has one.
    # methods, attributes: its methods that are called, and its attributes that are set, from
    # outside.
    methods: Sequence[str] = ()
    attributes: Sequence[str] = ()


@dataclass(slots=True)
class Tape:
    """Calls of one sensor's decoder, ready to be repeated."""

    calls: list[tuple[int, str, tuple[Any, ...]]] = field(default_factory=list[Any])
    functions: dict[str, Callable[..., Any]] = field(default_factory=dict[str, Any])
    make: Callable[[], Any] | None = None

    def play(self) -> float:
        """Repeat every call; return the seconds of processor time that it took."""
        instances: dict[int, Any] = {}
        begin = time.thread_time()
        for instance, name, arguments in self.calls:
            if name in self.functions:
                self.functions[name](*arguments)
                continue
            if instance not in instances:
                assert self.make is not None
                instances[instance] = self.make()
            if name.startswith("="):
                setattr(instances[instance], name[1:], *arguments)
            else:
                getattr(instances[instance], name)(*arguments)
        return time.thread_time() - begin


@contextmanager
def taping(taped: Taped, tape: Tape) -> Generator[None]:
    """Tape what is called meanwhile."""
    with ExitStack() as stack:
        for place in taped.functions:
            _tape_function(place, tape, stack)
        if taped.decoder:
            _tape_decoder(taped, tape, stack)
        yield


def _tape_function(place: str, tape: Tape, stack: ExitStack) -> None:
    module, _, name = place.partition(":")
    tape.functions[name] = resolve_name(place)
    recorder = _taped_function(tape, name, tape.functions[name])
    stack.enter_context(patch.object(resolve_name(module), name, recorder))


def _tape_decoder(taped: Taped, tape: Tape, stack: ExitStack) -> None:
    decoder = tape.make = resolve_name(taped.decoder)
    for method in taped.methods:
        recorder = _taped_method(tape, method, getattr(decoder, method))
        stack.enter_context(patch.object(decoder, method, recorder))
    if taped.attributes:
        recorder = _taped_setter(tape, taped.attributes)
        stack.enter_context(patch.object(decoder, "__setattr__", recorder))


def _taped_function(tape: Tape, name: str, original: Callable[..., Any]) -> Callable[..., Any]:
    def taped(*arguments: object) -> object:
        tape.calls.append((0, name, arguments))
        return original(*arguments)

    return taped


def _taped_method(tape: Tape, name: str, original: Callable[..., Any]) -> Callable[..., Any]:
    def taped(self: object, *arguments: object) -> object:
        tape.calls.append((id(self), name, arguments))
        return original(self, *arguments)

    return taped


def _taped_setter(tape: Tape, attributes: Sequence[str]) -> Callable[..., None]:
    def taped(self: object, name: str, value: object) -> None:
        # Those of the constructor are set again by every new decoder.
        if name in attributes and hasattr(self, name):
            tape.calls.append((id(self), f"={name}", (value,)))
        object.__setattr__(self, name, value)

    return taped
