"""python -m bodycheck."""

from __future__ import annotations

from bodycheck.cli import main

main()
