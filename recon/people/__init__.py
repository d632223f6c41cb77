"""Several people in one recording, fitted in one world."""
