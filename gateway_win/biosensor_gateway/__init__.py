"""The capture agent: talks to each sensor and re-emits its signals as LSL outlets."""
