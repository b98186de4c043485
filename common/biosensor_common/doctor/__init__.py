"""Finds problems of this computer and how to fix them; the part that both programs share.

`check` has the list of all checks, `report` runs them in parallel and prints their findings. A
program describes itself and its needs in a `Context`, and keeps its own checks in its own package.
A check is a function with the check's name and an entry in the list::

    def clock(context: Context) -> Iterator[Finding]: ...

Its module imports packages that are large or may fail to import (pylsl, psutil) inside functions.
A check may raise and may hang. LSL is used in a separate process (`probe`) with its own
configuration.
"""
