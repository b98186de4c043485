"""Writes a BIDS dataset, https://bids-specification.readthedocs.io, from one recording.

:mod:`.dataset` writes it and says whose folder a stream belongs to, :mod:`.file_names` what its
file is called there, and :mod:`.kinds` what kind of signal it is. :mod:`.signals` writes a stream
of numbers: as a table of equal steps (:mod:`.regular`) or of moments, as EEG (:mod:`.eeg`,
:mod:`.brain_vision`) or EMG (:mod:`.emg`) with files as :mod:`.run_file` says, or as gaze
(:mod:`.gaze`); :mod:`.sidecars` says what columns mean. Markers become tables of events
(:mod:`.events`), and several recordings one dataset (:mod:`.study`).
"""
