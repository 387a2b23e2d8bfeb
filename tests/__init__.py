"""Tests; a package, because an installed `tests` would hide a mere folder."""
