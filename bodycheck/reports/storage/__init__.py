"""Results on disk: sealed lines, the journal of a run, the cache of what was computed before."""
