"""Ensembles of random bodies: their statistics, and searches of the largest error."""
