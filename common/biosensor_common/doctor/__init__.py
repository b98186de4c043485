"""Finds what is wrong on this computer and how to fix it: what both programs have of it.

`check` has the list of all checks, `report` runs them side by side and shows what they found. A
program says in a `Context` what it is and what it needs, and has checks of its own in a room of
its own. A check is a function of its name, and a line of the list::

    def clock(context: Context) -> Iterator[Finding]: ...

Its module imports what is heavy, or may fail to import (pylsl, psutil), inside of functions; it
may raise and it may hang. Whatever LSL does, it does in a process of its own (`probe`), with
a configuration of its own.
"""
