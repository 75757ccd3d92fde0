"""Who is alive, who is missing, and what the team does about it."""
