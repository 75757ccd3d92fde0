"""Messages between robots: verified and decoded once, on receipt."""
