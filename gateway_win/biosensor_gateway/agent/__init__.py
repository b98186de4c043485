"""The running agent: devices, their supervisors, and how it is asked for things."""
