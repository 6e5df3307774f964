"""Privileged experts that move an object inside the hand: operator, search, verified goal chains."""
