"""The topics of a log: their survey, choice and clocks."""
