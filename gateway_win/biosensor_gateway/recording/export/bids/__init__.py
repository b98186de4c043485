"""Writes a BIDS dataset, https://bids-specification.readthedocs.io, from one recording.

:mod:`.dataset` writes it. :mod:`.subjects` says whose folder a stream belongs to and
:mod:`.file_names` what its file is called there. A regular stream becomes a table of equal
steps: :mod:`.timing` finds its rate and where it has to be cut, :mod:`.placing` gives every
sample its row, :mod:`.regular` writes the rows, and :mod:`.sidecars` what they mean;
:mod:`.motion` is for what moves. Streams without a rate become tables of moments
(:mod:`.irregular`), markers the table of events (:mod:`.events`).
"""
