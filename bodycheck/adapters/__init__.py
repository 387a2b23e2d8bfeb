"""Adapters of the engines to one common contract, see contract.py."""
