"""Exports recordings to formats of other programs: tables, EDF, text files, bags, BIDS.

:mod:`.job` opens a recording, selects the wanted parts, and writes each format to a
temporary place and then renames it; :mod:`.exporter` is the interface of the formats and lists
them by name. :mod:`.outcome` has the results and their sentences, :mod:`.tables` what all tables
of text share.
"""
