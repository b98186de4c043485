"""Tells which of two computers stands in the way of LSL between them.

One of them answers (`answering`), because a person there asked for it; the other asks
(`asking`). They talk by lines of JSON over TCP (`channel`) once both have proved that they
know a code which the first one shows (`handshake`). Each is a `station`, which opens test
ports and a test stream, sends to those of the other, and looks for its streams; what
both have found out (`facts`) is judged (`judgement`) and shown (`report`) on both.
"""
