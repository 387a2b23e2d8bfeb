"""The torque-free rotation of one rigid body in closed form: attitude and angular velocity at any time.

The principal axes are numbered so that L = (A1 cn, s A2 sn, A3 dn)(u), u = u0 + lambda t, with A1 >= 0,
A3 > 0 and s = +1 where the moments ascend, -1 where they descend (the two sides of the separatrix). In the
frame whose third axis is the angular momentum the attitude's Cayley-Klein parameters are, up to one common
real factor, single theta functions of the doubled nome, with x = pi u / 2K and z = x - i s pi a / 2K:

    alpha = exp(i Omega t / 2) theta4(z | q^2),    beta = s rho exp(i Omega t / 2) theta1(z | q^2).

Nothing in them is a difference of large numbers: neither beside the separatrix (where Jacobi's imaginary
transformation makes the series converge), nor for nearly symmetric bodies, nor for needles. What time
multiplies (lambda, Omega, K) is known to 106 bits, and the moments, principal axes and momentum with it;
where floating point leaves a doubt on which side of the separatrix the body is, exact integers decide.

Begin reading at `motions`; a state goes through `principal_axes`, `numbered_axes`, `decisions` and `tumble`,
a time through `state` and `series`.

Sources: Jacobi 1850, Sur la rotation d'un corps; Whittaker 1937, Analytical dynamics, par. 69-71; van Zon &
Schofield 2007, Numerical implementation of the exact dynamics of free rigid bodies, J. Comput. Phys. 225.
"""

from __future__ import annotations

from bodycheck.reference_impl.free_rotation.motions import FreeRotation, FreeRotations

__all__ = ["FreeRotation", "FreeRotations"]
