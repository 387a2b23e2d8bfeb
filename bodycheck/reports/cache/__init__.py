"""Answers of engines and truths that were computed before."""
