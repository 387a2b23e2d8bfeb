"""Closed forms of forced motions: rotation about a fixed axis or in stretched time, and flight."""
