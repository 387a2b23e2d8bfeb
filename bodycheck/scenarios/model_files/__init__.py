"""Read the bodies that URDF and MJCF files state, in 40-digit arithmetic and without any engine."""
