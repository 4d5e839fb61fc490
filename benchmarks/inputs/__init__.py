"""Tables and logs of every kind, written as other tools write them, and what homeward does."""
