"""Tables of comma-separated values, exact to the last bit.

:mod:`.wide` writes a table for each stream, a column a channel; :mod:`.long` one table for
all, a row a value. :mod:`.tables` has what both share.
Lines end in LF, decimals have a point, texts are quoted by RFC 4180, all is UTF-8.
"""
