"""Worker processes: the protocol, its messages, and both of its ends."""
