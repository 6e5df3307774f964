"""Paired comparison of action interfaces: rollouts, statistics and reports."""
