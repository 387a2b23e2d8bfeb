"""The audit of a model file: what it states, what importers make of it, and findings without engines."""
