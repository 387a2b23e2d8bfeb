"""Taylor integrators in double and double-double precision."""
