"""Helpers without mechanics, which every package may import."""
