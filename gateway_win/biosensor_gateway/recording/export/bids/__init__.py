"""Exports recordings to a BIDS dataset, see https://bids-specification.readthedocs.io.

:mod:`.dataset` writes a dataset and assigns streams to participants; :mod:`.file_names` has the
file names and :mod:`.kinds` the kinds of signals. :mod:`.signals` writes a numeric stream: as a
table with a fixed rate (:mod:`.regular`) or without, as EEG (:mod:`.eeg`, :mod:`.brain_vision`) or
EMG (:mod:`.emg`) with the files in :mod:`.run_file`, or as gaze (:mod:`.gaze`); :mod:`.sidecars`
describes the columns. Markers become tables of events (:mod:`.events`), and :mod:`.study` combines
several recordings in one dataset.
"""
