"""Command streams: what degrades an operator's commands, and the loop that executes them."""
