"""Derivatives of motions by the body and the start: exact ones, and those of differentiable engines."""
