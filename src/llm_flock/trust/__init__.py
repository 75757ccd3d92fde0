"""Keys, signatures and certificates of a team whose robots are separate processes.

Needs the `network` extra. Only the command line and the networked runtime import it.
"""
