"""Run one experiment of this folder, `python census/drivers MODULE EXPERIMENT`; print its figures as JSON."""

from __future__ import annotations

import json
import sys
from importlib import import_module

if __name__ == "__main__":
    module, experiment = sys.argv[1:]
    figures = getattr(import_module(module), experiment)()
    print("figures", json.dumps([float(figure) for figure in figures]))
