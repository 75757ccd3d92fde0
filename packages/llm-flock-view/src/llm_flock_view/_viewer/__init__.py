"""Web viewer: replays records, follows live runs, and steers simulated ones."""
