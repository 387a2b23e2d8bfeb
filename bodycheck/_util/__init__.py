"""Helpers that know nothing of mechanics; every room may import them."""
