"""A server of the Model Context Protocol: agents fly simulated missions and read records."""
