"""Who may speak: keys, signatures and certificates of a team whose robots are processes of their own.

The `network` extra. Nothing below the command line and the networked runtime imports it.
"""
