"""What engines report of trees, by the names of the methods of `tree_contract.TreeModel`."""

READINGS = (
    "mass_matrix",
    "bias",
    "gravity_bias",
    "accelerations",
    "wrenches",
    "energy",
    "momenta",
    "poses",
)
