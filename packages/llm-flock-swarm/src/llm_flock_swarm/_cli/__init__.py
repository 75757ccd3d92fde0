"""Commands of the command line that this part brings."""
