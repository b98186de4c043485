"""Computers on a network, made of Linux namespaces, and the programs that run on them.

`lan` makes the computers and disturbs their network; `programs` runs programs on them.
`subscriber`, `receiver` and `sender` are such programs, steered by lines of JSON; what
they received comes back as recordings, which `completeness` compares.
"""
