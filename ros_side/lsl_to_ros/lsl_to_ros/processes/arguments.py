"""Hands the command line of the node on to its further processes."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence

_BEGIN, _END = "--ros-args", "--"
# They come with what the first process starts the others with, as they are by then: a file of them
# names the node.
_OF_PARAMETERS = frozenset({"-p", "--param", "--params-file"})
_REMAPS = frozenset({"-r", "--remap"})
# Of whichever node.
_RENAMES = re.compile(r"(\w+:)?__(node|name|ns):=")


def for_further(arguments: Sequence[str], name: str) -> list[str]:
    """Return the arguments without parameters, and without the names of node and namespace.

    What is left are the remappings of topics, levels of the log, the enclave, and such.

    Parameters
    ----------
    name
        Of the node; a remapping for it alone is to hold for a further process, which has
        another name.
    """
    return list(_handed_on(iter(arguments), name))


def _handed_on(arguments: Iterator[str], name: str) -> Iterator[str]:
    is_ros = False
    for argument in arguments:
        is_ros = argument == _BEGIN or (is_ros and argument != _END)
        if is_ros and argument in _OF_PARAMETERS:
            next(arguments, None)
        elif is_ros and argument in _REMAPS:
            rule = next(arguments, "")
            if not _RENAMES.match(rule):
                yield from (argument, rule.removeprefix(f"{name}:"))
        else:
            yield argument
