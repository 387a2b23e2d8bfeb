"""The engines, each behind one small contract: see contract.py."""
