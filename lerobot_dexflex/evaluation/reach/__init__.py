"""The degraded-command benchmark: who recovers what the operator meant, and who merely damps."""
