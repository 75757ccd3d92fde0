"""Which plan the team follows, and who takes which slot: the paper's subject."""
