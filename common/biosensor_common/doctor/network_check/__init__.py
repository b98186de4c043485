"""Tells which of two computers stands in the way of LSL between them.

One of them answers, because a person there asked for it; the other asks (`sides`). They talk by
lines of JSON over TCP once both have proved that they know a code which the first one shows
(`channel`). Each is a `station`, which opens LSL's ports and one test stream, sends to those of
the other, and looks for its streams; what both have found out (`facts`) is judged (`judgement`)
and shown (`command`) on both.
"""
