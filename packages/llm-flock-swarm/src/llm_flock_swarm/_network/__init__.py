"""One robot, one process: the same state machine on a real network, each robot with its own clock."""
