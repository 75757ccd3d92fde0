"""Makes a report of a directory of results: statistics of its trials, figures, and a page that shows both."""
