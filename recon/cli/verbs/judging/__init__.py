"""Verbs that judge a motion: against the truth, or as a laboratory reads it."""
