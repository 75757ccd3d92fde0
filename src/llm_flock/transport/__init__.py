"""How messages travel between robots."""
