"""Exports recordings to a BIDS dataset, see https://bids-specification.readthedocs.io.

:mod:`.dataset` writes a dataset and assigns streams to participants; :mod:`.file_names` has the
file names and the kinds of signals. :mod:`.signals` writes a numeric stream: as a table with a
fixed rate (:mod:`.regular`) or without, as EEG or EMG (:mod:`.run_file`, :mod:`.brain_vision`), or
as gaze (:mod:`.gaze`); :mod:`.sidecars` describes the columns. Markers become tables of events,
and :mod:`.study` combines several recordings in one dataset.
"""
