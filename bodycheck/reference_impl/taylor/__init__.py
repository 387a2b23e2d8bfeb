"""The Taylor integrators, in doubles and in double-doubles."""
