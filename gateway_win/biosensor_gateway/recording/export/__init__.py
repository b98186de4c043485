"""Turns recordings into what others load: tables, EDF, texts for single programs, bags, BIDS.

:mod:`.exporting` opens a recording, cuts out what is wanted, and has each format written
beside and then renamed; :mod:`.formats` has them by name, and :mod:`.exporter` says what a
format is. :mod:`.printing` tells what was written.
"""
