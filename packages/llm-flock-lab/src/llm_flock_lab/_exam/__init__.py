"""An exam for language models: fixed questions of the kinds that robots ask, scored by code, and a leaderboard."""
