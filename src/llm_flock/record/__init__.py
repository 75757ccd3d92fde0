"""One run is one MCAP file: written as it happens, read by everything that shows results."""
