"""Read the bodies that URDF, MJCF and SDFormat files state, in 40-digit arithmetic and without any engine."""
