"""Pinocchio by itself."""

from __future__ import annotations

import numpy as np
import pinocchio as pin


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
