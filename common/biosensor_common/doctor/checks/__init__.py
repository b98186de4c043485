"""The checks that any computer with LSL can run; `biosensor_common.doctor.table` lists them."""
