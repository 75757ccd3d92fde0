"""Keys and envelopes of a team whose robots are separate processes. Needs the `network` extra."""
