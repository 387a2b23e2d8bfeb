"""The mathematics of one rigid body, from scratch: knows no engine and no file format."""
