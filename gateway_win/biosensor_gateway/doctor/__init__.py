"""``biosensor-gateway doctor``: what is wrong on this computer, and how to mend it.

`table` lists the checks, `runner` runs them side by side, `report` shows what they found.
A check is a module of `checks` with one function::

    def examine(context: Context) -> Iterator[Finding]: ...

It imports what is heavy, or may fail to import, inside its functions; it may raise and it
may hang. Whatever LSL does, it does in a process of its own (`probe`), with a
configuration of its own.
"""
