"""Gymnasium tasks of the tactile hand."""
