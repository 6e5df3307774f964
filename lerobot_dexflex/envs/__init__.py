"""Gymnasium tasks of the tactile LEAP hand."""
