"""bodycheck tells whether a rigid-body engine is right, how right at what speed, and whether that changed."""
