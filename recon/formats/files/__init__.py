"""How any file is opened, checked for size and damage, and replaced in one step."""
