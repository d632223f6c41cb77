"""Verbs that make motions of people who were not recorded."""
