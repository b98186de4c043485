"""Finds what is wrong on this computer and how to mend it: the part of both programs.

`table` lists the checks that any computer with LSL can run, `runner` runs them side by
side, `report` shows what they found. A program adds its own checks in a table of its own,
and says in a `Context` what it is and what it needs. A check is a module with one
function::

    def examine(context: Context) -> Iterator[Finding]: ...

It imports what is heavy, or may fail to import (pylsl, psutil), inside its functions; it
may raise and it may hang. Whatever LSL does, it does in a process of its own (`probe`),
with a configuration of its own.
"""
