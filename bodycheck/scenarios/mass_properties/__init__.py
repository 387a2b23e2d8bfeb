"""Mass, centre of mass and inertia tensor of solids: closed forms, closed meshes, implicit shapes."""
