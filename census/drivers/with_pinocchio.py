"""Pinocchio by itself."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from exact import SPIN, TOP, angle, of_quaternion, order, top


def _free() -> pin.Model:
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "free")
    model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), np.diag(TOP)), pin.SE3.Identity())
    model.gravity = pin.Motion.Zero()
    return model


def depth_first() -> list[float]:
    """Largest |crba - M| / max |M| of a branched tree, M by rnea: not depth first, and depth first.

    Joint 1 carries 2 and 3, and 2 carries 4 in the first order; 2 carries 3 and 1 carries 4 in the second.
    """
    found = []
    for parents in ((0, 1, 1, 2), (0, 1, 2, 1)):
        model = pin.Model()
        for k, parent in enumerate(parents):
            place = pin.SE3(np.eye(3), np.array([0.3 * k, 0.2, 0.1]))
            kind = (pin.JointModelRX, pin.JointModelRY, pin.JointModelRZ, pin.JointModelRY)[k]
            joint = model.addJoint(parent, kind(), place, f"j{k}")
            tensor = np.diag([0.1, 0.2, 0.25])
            model.appendBodyToJoint(
                joint, pin.Inertia(1.0, np.array([0.1, 0.0, 0.2]), tensor), pin.SE3.Identity()
            )
        model.gravity = pin.Motion.Zero()
        data = model.createData()
        q, zero = np.array([0.3, -0.4, 0.5, 0.2]), np.zeros(4)
        upper = np.triu(pin.crba(model, data, q).copy())
        matrix = upper + np.triu(upper, 1).T
        exact = np.column_stack([pin.rnea(model, data, q, zero, unit).copy() for unit in np.eye(4)])
        found.append(float(np.max(np.abs(matrix - exact)) / np.max(np.abs(exact))))
    return found


def rk4_order() -> list[float]:
    """Order of textbook Runge-Kutta 4 by integrate of a mean of rates, and its error at 1e-2 s."""
    model = _free()
    data = model.createData()
    errors = []
    for dt in (2e-2, 1e-2):
        q, v = pin.neutral(model), np.concatenate([np.zeros(3), SPIN])
        for _ in range(round(1.0 / dt)):
            k, a = [v], [pin.aba(model, data, q, v, np.zeros(6)).copy()]
            for c in (0.5, 0.5, 1.0):
                k.append(v + c * dt * a[-1])
                a.append(
                    pin.aba(model, data, pin.integrate(model, q, c * dt * k[-2]), k[-1], np.zeros(6)).copy()
                )
            q = pin.integrate(model, q, dt / 6 * (k[0] + 2 * k[1] + 2 * k[2] + k[3]))
            v = v + dt / 6 * (a[0] + 2 * a[1] + 2 * a[2] + a[3])
        x, y, z, w = q[3:]
        errors.append(angle(top(1.0), of_quaternion(w, x, y, z)))
    return [order(*errors), errors[1]]


def straight_line() -> list[float]:
    """Distance from the straight line after 1 s at 1e-2 s in a semi-implicit loop; its order."""
    model = _free()
    data = model.createData()
    errors = []
    for dt in (1e-2, 5e-3):
        q, v = pin.neutral(model), np.concatenate([[1.0, 0.0, 0.0], SPIN])
        for _ in range(round(1.0 / dt)):
            v = v + dt * pin.aba(model, data, q, v, np.zeros(6))
            q = pin.integrate(model, q, dt * v)
        errors.append(float(np.linalg.norm(q[:3] - np.array([1.0, 0.0, 0.0]))))
    return [errors[0], order(*errors)]
