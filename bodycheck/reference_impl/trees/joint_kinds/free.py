"""No joint: a body that moves freely in the world."""

from bodycheck.reference_impl.trees.joint_kind import JointKind, Rotation, Translation

JOINT = JointKind("free", Rotation.BALL, Translation.SPACE)
