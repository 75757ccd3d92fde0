"""Runs in Foxglove: its channels, live by a WebSocket server, and as an indexed file."""
