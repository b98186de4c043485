"""The fault matrix: every fault that can hit a device, for every sensor at once."""
