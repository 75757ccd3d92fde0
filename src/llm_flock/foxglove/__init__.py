"""Runs in Foxglove: its channels, live by a WebSocket server with orders, and as an indexed file."""
