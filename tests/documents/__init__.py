"""Tests of the README, the pages of docs/, the site made of them, and the examples."""
