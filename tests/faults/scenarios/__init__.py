"""What happens in a lab to the agent, the recording and the devices as a whole."""
