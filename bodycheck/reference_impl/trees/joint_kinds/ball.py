"""A ball joint: the child turns freely about the joint's point."""

from bodycheck.reference_impl.trees.joint_kind import JointKind, Rotation, Translation

JOINT = JointKind("ball", Rotation.BALL, Translation.NONE)
