"""``biosensor-gateway doctor``: finds problems of this computer, with their fixes.

The list of checks, their runner and report, and the checks for any computer with LSL are in
`biosensor_common.doctor`. This package has the checks for the agent, `scan`, and the test of one
device.
"""
