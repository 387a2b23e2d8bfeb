"""A motion beside the truth, with energy and momentum along both: what every measure is a function of."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.dynamics import angular_momentum, linear_momentum
from bodycheck.reference_impl.imu import ImuReadings, has_imu
from bodycheck.reference_impl.pivot import kinetic_energies, rotational_inertia
from bodycheck.reference_impl.scene import Scene
from bodycheck.reference_impl.trajectory import Trajectory
from bodycheck.reference_impl.trees.tree_bodies import tree_momenta, tree_potential_energy
from bodycheck.reference_impl.trees.tree_scene import TreeScene
from bodycheck.reference_impl.truth.motion_distance import potential_energy
from bodycheck.reports.measurement.invariants import Invariant, InvariantDrift, invariant_drifts
from bodycheck.reports.measurement.joint_errors import JointErrors, joint_errors
from bodycheck.reports.measurement.work import does_work, work_done

_RESOLVED = 3.0  # an imbalance below this many errors of the work counts as not measured


@dataclass(frozen=True, eq=False)
class EnergyAndMomentum:
    """Energy and momentum along a trajectory: K, its rotational part and E (n,) in J, L and P (n, 3)."""

    kinetic: Array
    rotational: Array
    energy: Array
    angular_momentum: Array
    linear_momentum: Array

    @classmethod
    def of(cls, scene: Scene | TreeScene, trajectory: Trajectory) -> EnergyAndMomentum:
        """E = K + U, U from gravity (zero at the start) and loads; L about the centre of mass, world axes.

        For a body with a pivot, E and L are taken about the pivot; of a tree, L about the world's origin.
        """
        kinetic, rotational = kinetic_energies(scene, trajectory)
        if isinstance(scene, TreeScene):
            linear, angular = tree_momenta(scene, trajectory)
            energy = kinetic + tree_potential_energy(scene, trajectory)
            return cls(kinetic, rotational, energy, angular, linear)
        inertia = rotational_inertia(scene)
        return cls(
            kinetic=kinetic,
            rotational=rotational,
            energy=kinetic + potential_energy(scene, trajectory),
            angular_momentum=angular_momentum(trajectory.rotation_matrices, inertia, trajectory.omega_body),
            linear_momentum=linear_momentum(scene.body.mass, trajectory.velocity_m_s),
        )


@dataclass(frozen=True, eq=False)
class Compared:
    """A trajectory and the truth at the same n samples, with energy and momentum along both.

    until: number of leading samples at which the truth can be trusted.
    """

    scene: Scene | TreeScene
    truth: Trajectory
    true: EnergyAndMomentum
    trajectory: Trajectory
    motion: EnergyAndMomentum
    invariants: Sequence[Invariant]
    until: int

    @cached_property
    def balance(self) -> tuple[Array, float] | None:
        """E - E(0) - W (n,) and the error of W, in J; None where the samples are too coarse to resolve W."""
        gained = self.motion.energy - self.motion.energy[0]
        if not does_work(self.scene):
            return gained, 0.0
        done = work_done(self.scene, self.trajectory)
        if done is None:
            return None
        work, error = done
        return (gained - work, error) if _RESOLVED * error <= float(np.max(np.abs(gained - work))) else None

    @cached_property
    def joints(self) -> JointErrors | None:
        """The errors of the joints of a tree; None for one body."""
        if not isinstance(self.scene, TreeScene):
            return None
        return joint_errors(self.scene, self.truth, self.trajectory)

    @cached_property
    def imu(self) -> ImuReadings | None:
        """The true readings of sensors; None where the trajectory has none, or they are not defined."""
        scene = self.scene
        if self.trajectory.specific_force_m_s2 is None or isinstance(scene, TreeScene) or not has_imu(scene):
            return None
        return ImuReadings.of(scene, self.truth)

    @cached_property
    def invariant_drifts(self) -> list[InvariantDrift]:
        """The departure of each of the scene's invariants from the truth's, (until,)."""
        drifts = invariant_drifts(self.invariants, self.truth, self.trajectory)
        return [replace(drift, departure=drift.departure[: self.until]) for drift in drifts]
