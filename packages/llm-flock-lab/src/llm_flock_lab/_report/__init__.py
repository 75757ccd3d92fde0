"""From a directory of results to a report: what the trials say, the figures of it, and a page that shows both."""
