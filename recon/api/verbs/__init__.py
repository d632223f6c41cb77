"""What `recon` does besides fitting: one function per verb, with the manners of `recon.fit`."""
