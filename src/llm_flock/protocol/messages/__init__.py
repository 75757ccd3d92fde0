"""What robots say to each other: decoded once when it comes in, then a value."""
