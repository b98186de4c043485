"""Exports recordings to formats of other programs: tables, EDF, text files, bags, BIDS.

:mod:`.exporting` opens a recording, selects the wanted parts, and writes each format to a
temporary place and then renames it; :mod:`.formats` lists the formats by name, and
:mod:`.exporter` is their interface. :mod:`.printing` formats the results.
"""
