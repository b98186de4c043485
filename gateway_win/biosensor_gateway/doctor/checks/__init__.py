"""The agent's own checks, one module each; `biosensor_gateway.doctor.table` lists them."""
