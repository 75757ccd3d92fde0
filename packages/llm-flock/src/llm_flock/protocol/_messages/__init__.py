"""Messages between robots: verified and decoded once on receipt, and a value from then on."""
