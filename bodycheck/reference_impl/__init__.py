"""The mathematics of one rigid body, implemented from scratch; independent of engines and file formats."""
