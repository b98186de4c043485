"""The running agent: devices, their supervisors, pauses and the control channel."""
