"""The certified truth: a motion with bounds on its own error."""
