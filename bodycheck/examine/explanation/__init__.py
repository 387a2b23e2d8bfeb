"""Which cases of a run are diagnosed, and the explanations as documents."""
