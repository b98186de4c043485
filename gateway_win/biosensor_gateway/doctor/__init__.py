"""``biosensor-gateway doctor``: finds what is wrong on this computer, and says how to mend it.

The checks that any computer with LSL can run are in `biosensor_common.doctor`, with what
runs and shows them; the agent's own are in `checks`. `table` lists both.
"""
