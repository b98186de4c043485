"""A virtual BioHarness 3: a source of packets, a conversation and a serial link."""
