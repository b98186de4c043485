"""``biosensor-gateway doctor``: finds what is wrong on this computer, and says how to fix it.

The list of checks, what runs and shows them, and the checks that any computer with LSL can run
are in `biosensor_common.doctor`; here are those that only the agent can run, `scan`, and the test
of one device.
"""
