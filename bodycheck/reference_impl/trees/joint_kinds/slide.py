"""A slide: the child moves along an axis without turning."""

from bodycheck.reference_impl.trees.joint_kind import JointKind, Rotation, Translation

JOINT = JointKind("slide", Rotation.NONE, Translation.AXIS)
