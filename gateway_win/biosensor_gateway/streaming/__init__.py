"""What a device's samples go through on their way into LSL."""
