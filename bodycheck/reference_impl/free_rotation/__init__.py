"""The torque-free rotation of one rigid body in closed form: attitude and angular velocity at any time.

The principal axes are numbered so that L = (A1 cn, s A2 sn, A3 dn)(u), u = u0 + lambda t, with A1 >= 0,
A3 > 0 and s = +1 where the moments ascend, -1 where they descend (the two sides of the separatrix). In the
frame whose third axis is the angular momentum, the attitude's Cayley-Klein parameters are single theta
functions of the doubled nome, up to one common real factor, with x = pi u / 2K and z = x - i s pi a / 2K:

    alpha = exp(i Omega t / 2) theta4(z | q^2),    beta = s rho exp(i Omega t / 2) theta1(z | q^2).

No term is a difference of large numbers: neither near the separatrix (where Jacobi's imaginary
transformation makes the series converge), nor for nearly symmetric bodies, nor for needles. The factors of
time (lambda, Omega, K) are accurate to 106 bits, as are the moments, principal axes and momentum. Where
floating point cannot tell on which side of the separatrix the body is, exact integer arithmetic decides.

Start reading at `free_rotations`. A state passes through `set_up`, `tensor_axes`, `classification` and
`tumbling_constants`; a time passes through `principal_state`.

Sources: Jacobi 1850, Sur la rotation d'un corps; Whittaker 1937, Analytical dynamics, par. 69-71; van Zon &
Schofield 2007, Numerical implementation of the exact dynamics of free rigid bodies, J. Comput. Phys. 225.
"""

from __future__ import annotations

from bodycheck.reference_impl.free_rotation.free_rotations import FreeRotation, FreeRotations

__all__ = ["FreeRotation", "FreeRotations"]
