"""The living team: heartbeats, missing robots, replanning, and the assembly of large teams."""
