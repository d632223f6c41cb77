"""Files in, files out: what each command does, without its command line."""
