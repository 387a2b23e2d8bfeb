"""Forced motions with a closed form: rotation about a fixed axis or in stretched time, and flight."""
