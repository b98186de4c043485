"""Finds which of two computers blocks LSL between them.

A user starts one of them as the answering side; the other one connects to it (`sides`). They
exchange lines of JSON over TCP after both have proved that they know a code, which the answering
side shows (`channel`). Each runs a `station`, which opens LSL's ports and one test stream, sends to
the other's ports, and searches for its streams. The results of both (`facts`) are evaluated
(`diagnosis`) and shown (`command`) on both.
"""
