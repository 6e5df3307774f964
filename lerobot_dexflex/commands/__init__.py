"""What goes wrong with commands, where it enters, and the loop in which an operator's are executed."""
