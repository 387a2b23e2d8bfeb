"""A hinge: the child turns about an axis through the joint's point."""

from bodycheck.reference_impl.trees.joint_kind import JointKind, Rotation, Translation

JOINT = JointKind("hinge", Rotation.AXIS, Translation.NONE)
